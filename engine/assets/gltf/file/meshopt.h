// EXT_meshopt_compression: decodes the bytes of a bufferView with libmeshoptimizer.
#pragma once

#include "engine/result.h"

#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

namespace raynest::gltf {

/// Returns an error with the remedy if the build lacks the library.
Result<void> meshopt_available();

/// A compressed bufferView as the file states it, unchecked.
struct MeshoptView {
    std::span<const std::byte> stream;
    std::uint64_t count = 0;
    std::uint64_t stride = 0;
    std::string_view mode = {};        ///< "ATTRIBUTES", "TRIANGLES" or "INDICES"
    std::string_view filter = "NONE";  ///< or "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL"
};

/// Returns the decoded size. Refuses modes, filters and sizes that the extension does not allow,
/// and a count that the stream is too short to hold. Pass errors to blame().
Result<std::uint64_t> meshopt_bytes(const MeshoptView& view);
/// Decodes `view`, which has passed meshopt_bytes.
Result<std::vector<unsigned char>> decode_meshopt(const MeshoptView& view);

}  // namespace raynest::gltf
