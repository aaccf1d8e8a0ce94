// A scene as a binary glTF 2.0 file that is never whole in memory.
//
// The JSON and the pictures are made; vertices and indices are copied out of the scene's arena when
// somebody reads their bytes.
//
//   12 bytes | JSON: length, "JSON", text | BIN: length, "BIN", arena ranges, pictures
#pragma once

#include "engine/result.h"
#include "engine/scene/snapshot.h"

#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <span>
#include <string>
#include <vector>

namespace raynest::gltf {

/// The bytes of a file as ranges one behind the other.
class GlbFile {
public:
    /// Returns the most bytes that a file of the scene holds in memory. limit_exceeded: the scene
    /// expands to more nodes than a file may have (ImportLimits::nodes_max), for glTF gives each
    /// node one parent. Linear in the scene's tables.
    static Result<std::uint64_t> memory_max(const Snapshot& scene);

    /// Makes the file of a scene, linear in its vertices. `scene` must outlive it. limit_exceeded:
    /// the file would pass 4 GiB, or its JSON what a reader takes. scene_unsupported: no picture
    /// can be encoded. field_invalid: `stop` returned true. Throws std::bad_alloc.
    static Result<GlbFile> make(const Snapshot& scene, const std::function<bool()>& stop);

    [[nodiscard]] std::uint64_t bytes() const { return bytes_; }
    /// Copies the bytes from `offset` on; they must be there. Thread-safe.
    void read(std::uint64_t offset, std::span<std::byte> into) const;
    /// Parts of the scene that the file lacks, for glTF cannot say them: a line each, with counts.
    [[nodiscard]] const std::vector<std::string>& warnings() const { return warnings_; }

private:
    friend class GlbWriter;
    struct Range {
        std::uint64_t offset;  ///< in the file
        std::span<const std::byte> bytes;
    };
    void add(std::span<const std::byte> bytes);

    std::vector<Range> ranges_;
    std::deque<std::vector<std::byte>> made_;  ///< what the ranges refer to beside the arena
    std::uint64_t bytes_ = 0;
    std::vector<std::string> warnings_;
};

/// Returns the composition that places the file `glb` as the scene lies in the world: its origin,
/// and the user id if all instances have the same one. `glb` is a name without folders.
[[nodiscard]] std::string composition_text(const Snapshot& scene, const std::string& glb);

}  // namespace raynest::gltf
