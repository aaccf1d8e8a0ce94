// geotiff.h, implemented by the module.
#include "engine/assets/formats/geotiff.h"

#include "engine/system/module.h"

namespace raynest {

Result<HeightGrid> decode_geotiff(std::span<const std::byte> file, std::uint64_t heights_max) {
    constexpr std::size_t bytes = 64U << 20;
    const auto symbol = load_module(
        {geotiff_module_file, geotiff_module_symbol, bytes, "a .tif needs the TIFF module",
         "install libtiff-dev and build RayNest again, or save the heights with "
         "numpy.save()"});
    if (!symbol) return tl::unexpected(symbol.error());
    return reinterpret_cast<GeotiffModuleEntry>(*symbol)()(file, heights_max);
}

}  // namespace raynest
