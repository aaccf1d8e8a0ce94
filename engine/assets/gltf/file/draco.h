// KHR_draco_mesh_compression: decodes the triangles and attributes of a primitive with libdraco.
//
// libdraco.so exports its own, different version of tinygltf, whose symbols would replace ours. So
// a module (draco_module.cpp) hides it. The first compressed mesh loads the module.
#pragma once

#include "engine/assets/gltf/file/model.h"

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace raynest::gltf {

/// Returns an error with the remedy if the build lacks the library.
Result<void> draco_available();

/// An attribute to extract from a stream, in the form that its accessor states.
struct DracoAttribute {
    std::uint32_t id = 0;  ///< the stream's unique id
    Component component = Component::f32;
    std::uint32_t width = 0;
};

struct DracoMesh {
    std::uint32_t points = 0;
    std::vector<unsigned char> indices;                  ///< three u32 per triangle
    std::vector<std::vector<unsigned char>> attributes;  ///< packed, in the order of the request
};

/// Decodes at most `bytes_max` bytes; the stream's header is checked against this limit before
/// anything is allocated. Pass errors to blame().
Result<DracoMesh> decode_draco(std::span<const std::byte> stream,
                               std::span<const DracoAttribute> wanted, std::uint64_t bytes_max);

/// Type of the module's only exported symbol, which returns its decode_draco.
using DracoModuleEntry = decltype (&decode_draco) (*)() noexcept;
inline constexpr const char* draco_module_file = "raynest-draco.so";
inline constexpr const char* draco_module_symbol = "raynest_draco";

}  // namespace raynest::gltf
