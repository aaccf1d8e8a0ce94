// Writes point clouds: binary PLY, PCD and LAS. The Python client's raynest.points.save() writes
// the same bytes.
#pragma once

#include "client/ground/failure.h"

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::client {

/// A column of `width` numbers per point.
struct PointColumn {
    std::string name;
    std::string dtype;  ///< NumPy's: "|u1", "<u2", "<u4", "<f4" or "<f8"
    std::vector<std::byte> values;
    std::uint32_t width = 1;
};

inline constexpr std::array<std::string_view, 3> point_endings{".ply", ".pcd", ".las"};
/// True for an ending of the files that this can write.
[[nodiscard]] bool is_point_ending(std::string_view ending);

/// Returns which of these columns is where the points stand: `position`, or without it
/// `sensor_position`; "" if there is neither.
[[nodiscard]] std::string_view place_of(std::span<const std::string> columns);

/// Fails with exit code 2 for a column that a LAS has no room for. It has for `position`, `return`,
/// from 0, and `returns`, of the same ray, `time` (GPS time), `ring` (user data) and `reflectance`
/// (intensity), and `base_colour`.
Result<void> check_las_column(std::string_view name);
/// Returns the file of points x y z, three numbers each, by its ending. A wide column becomes name_0,
/// name_1, ...; but `normal` and `base_colour` have the names under which other programs read them:
/// nx ny nz and red green blue (sRGB), in a PCD normal_x normal_y normal_z and a packed rgb. Fails with
/// exit code 2 for columns that it has no room for.
Result<std::vector<std::byte>> format_points(std::string_view ending,
                                             std::span<const double> positions,
                                             std::span<const PointColumn> columns);

}  // namespace raynest::client
