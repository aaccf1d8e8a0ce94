// Heights in a TIFF, and where they lie on the map if it is a GeoTIFF.
//
// libtiff reads them in a module (geotiff_module.cpp), as it needs six other libraries. The first
// .tif loads the module.
#pragma once

#include "engine/result.h"

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

namespace raynest {

/// Heights in rows from north to south, as a rule; NaN where there is none.
struct HeightGrid {
    std::uint64_t columns = 0;
    std::uint64_t rows = 0;
    std::vector<double> heights;  ///< row after row
    /// East and north of a height: (0) + (1) * column + (2) * row, and (3) + (4) * column + (5) *
    /// row. Nothing without georeference.
    std::optional<std::array<double, 6>> to_map;
    bool is_in_degrees = false;
    std::uint32_t unit = 0;         ///< EPSG's code of the map's unit of length; 0: not said
    std::uint32_t height_unit = 0;  ///< the heights' unit; 0: not said
};

/// Reads the first picture of a TIFF: one band of 8 to 64 bits, in strips or tiles. limit_exceeded:
/// over heights_max heights. Errors have one line without the file's name.
Result<HeightGrid> decode_geotiff(std::span<const std::byte> file, std::uint64_t heights_max);

/// Type of the module's only exported symbol, which returns its decode_geotiff.
using GeotiffModuleEntry = decltype (&decode_geotiff) (*)() noexcept;
inline constexpr const char* geotiff_module_file = "raynest-geotiff.so";
inline constexpr const char* geotiff_module_symbol = "raynest_geotiff";

}  // namespace raynest
