// The messages between the daemon and its import child: a request on fd 3, a result on fd 4.
//
// Both are memory files, so neither side can block the other. The parent writes the request; the
// child trusts its framing but not the files inside it. The parent does not trust the result,
// because hostile input may control the child.
#pragma once

#include "engine/assets/images/image.h"
#include "engine/assets/input/import_request.h"
#include "engine/result.h"
#include "engine/scene/snapshot.h"
#include "engine/system/child_process.h"

#include <cstddef>
#include <span>

namespace raynest::wire {

inline constexpr int request_fd = first_inherited_fd;
inline constexpr int result_fd = first_inherited_fd + 1;

enum class Work : std::uint32_t {
    scene,        ///< answered by an arena
    environment,  ///< files[0] is a picture; answered by its linear colours
    exr,          ///< files[0] is an EXR; answered by its channels
};

struct Message {
    Work work = Work::scene;
    ImportRequest request;  ///< points into the mapped message
    ImportLimits limits;
    int parent = 0;  ///< process id of the sender
};

Result<void> write_request(int fd, Work work, const ImportRequest& request,
                           const ImportLimits& limits);
/// Parses a request; `bytes` must outlive the message.
Result<Message> parse_request(std::span<const std::byte> bytes);

Result<void> write_result(int fd, const Result<BuiltArena>& result);
Result<void> write_result(int fd, const Result<LightPicture>& result);
Result<void> write_result(int fd, const Result<ExrPlanes>& result);
/// Returns the child's arena, checked by Snapshot::open, or its error. Reads at most
/// `scene_bytes_max` bytes of arena.
Result<std::shared_ptr<const Snapshot>> read_result(int fd, std::uint64_t scene_bytes_max);
/// Returns the child's picture, checked against image_side_max and image_bytes_max, or its error.
Result<LightPicture> read_light(int fd, const ImportLimits& limits);
/// Returns the child's planes, or its error. They must be `planes` planes of exactly this size.
Result<ExrPlanes> read_planes(int fd, std::uint32_t width, std::uint32_t height,
                              std::size_t planes);

}  // namespace raynest::wire
