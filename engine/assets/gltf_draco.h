// KHR_draco_mesh_compression: the triangles and attributes of a primitive, by libdraco.
//
// libdraco.so exports a tinygltf of its own, of another version, which would be called in place of
// ours. So a module (gltf_draco_module.cpp) keeps it to itself, loaded with the first compressed
// mesh.
#pragma once

#include "engine/assets/gltf_model.h"

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace raynest::gltf {

/// An error, with the remedy, in a build without the library.
Result<void> draco_available();

/// An attribute to take out of a stream, in the form that its accessor states.
struct DracoAttribute {
    std::uint32_t id = 0;  ///< the stream's unique id
    Component component = Component::f32;
    std::uint32_t width = 0;
};

struct DracoMesh {
    std::uint32_t points = 0;
    std::vector<unsigned char> indices;                  ///< three u32 per triangle
    std::vector<std::vector<unsigned char>> attributes;  ///< packed, in the order asked for
};

/// Decodes to at most `bytes_max` bytes, which is checked against the stream's own header before
/// anything is allocated. Errors are for blame().
Result<DracoMesh> decode_draco(std::span<const std::byte> stream,
                               std::span<const DracoAttribute> wanted, std::uint64_t bytes_max);

/// The module exports one symbol, which returns its decode_draco.
using DracoModuleEntry = decltype (&decode_draco) (*)() noexcept;
inline constexpr const char* draco_module_file = "raynest-draco.so";
inline constexpr const char* draco_module_symbol = "raynest_draco";

}  // namespace raynest::gltf
