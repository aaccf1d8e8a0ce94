// draco.h, implemented by the module.
#include "engine/assets/gltf/file/draco.h"

#include "engine/system/module.h"

namespace raynest::gltf {
namespace {

Result<decltype(&decode_draco)> draco_module() {
    constexpr std::size_t bytes = 64U << 20;
    const auto symbol =
        load_module({draco_module_file, draco_module_symbol, bytes,
                     "KHR_draco_mesh_compression needs the Draco module",
                     "install libdraco-dev and build RayNest again, or re-export without "
                     "compression"});
    if (!symbol) return error_of(symbol);
    return reinterpret_cast<DracoModuleEntry>(*symbol)();
}

}  // namespace

Result<void> draco_available() {
    const auto module = draco_module();
    if (!module) return error_of(module);
    return {};
}

Result<DracoMesh> decode_draco(std::span<const std::byte> stream,
                               std::span<const DracoAttribute> wanted, std::uint64_t bytes_max) {
    const auto module = draco_module();
    if (!module) return error_of(module);
    return (*module)(stream, wanted, bytes_max);
}

}  // namespace raynest::gltf
