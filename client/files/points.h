// Writes point clouds: binary PLY, PCD and LAS. The Python client's raynest.points.save() writes
// the same bytes.
#pragma once

#include "client/ground/failure.h"

#include <array>
#include <cstddef>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::client {

/// One number per point.
struct PointColumn {
    std::string name;
    std::string dtype;  ///< NumPy's: "|u1", "<u2", "<u4", "<f4" or "<f8"
    std::vector<std::byte> values;
};

inline constexpr std::array<std::string_view, 3> point_endings{".ply", ".pcd", ".las"};
/// True for an ending of the files that this can write.
[[nodiscard]] bool is_point_ending(std::string_view ending);

/// Returns the file of points x y z, three numbers each, by its ending. A LAS has room for the
/// columns `return`, from 0, and `returns`, of the same ray, `time` (GPS time) and `ring` (user
/// data); others fail with exit code 2.
Result<std::vector<std::byte>> format_points(std::string_view ending,
                                             std::span<const double> positions,
                                             std::span<const PointColumn> columns);

}  // namespace raynest::client
