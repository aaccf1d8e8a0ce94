// The files of a request, by name.
#pragma once

#include "engine/assets/input/import_request.h"
#include "engine/result.h"

#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>

namespace raynest {

/// True if the source's name ends in `extension`, in upper or lower case: Windows tools write both.
[[nodiscard]] bool has_extension(std::string_view source, std::string_view extension);
/// True for the names of glTF files.
[[nodiscard]] inline bool is_gltf(std::string_view source) {
    return has_extension(source, ".glb") || has_extension(source, ".gltf");
}

/// The uploaded files as a loader sees them: by exact name, and with a limit on the total bytes
/// read, for scenes that name one file a thousand times to use up memory.
class Upload {
public:
    Upload(const ImportRequest& request, std::uint64_t bytes_max)
        : request_(request),
          bytes_left_(bytes_max) {}

    /// Returns the file's bytes; a span without data if it was not uploaded. limit_exceeded when
    /// the scene reads more than `bytes_max`.
    Result<std::span<const std::byte>> read(std::string_view name);

private:
    const ImportRequest& request_;
    std::uint64_t bytes_left_;
};

}  // namespace raynest
