// Grids of heights as meshes: .npy arrays, and TIFFs with their place on the map.
#include "engine/assets/formats/formats.h"
#include "engine/assets/formats/geotiff.h"
#include "engine/assets/formats/npy_array.h"
#include "engine/assets/input/messages.h"

#include <fmt/format.h>

#include <array>
#include <cmath>
#include <cstdint>
#include <string_view>
#include <utility>
#include <vector>

namespace raynest {
namespace {

/// Returns a mesh with a vertex for each height, at position(row, column, height), where y is up;
/// the mesh is turned to `up`. Cells with a
/// corner that is NaN are holes; `hole` names such a height: "NaN". Faces look up where rows go
/// south, or, `is_mirrored`, where they go north.
template <class HeightAt, class Position>
FileContent mesh_of(UpAxis up, std::uint64_t rows, std::uint64_t columns, std::string_view hole,
                    bool is_mirrored, const HeightAt& height_at, const Position& position) {
    FileContent content;
    content.objects.push_back({{}, {FileGeometry{}}});
    FileGeometry& geometry = content.objects.back().geometries.back();
    geometry.positions.reserve(rows * columns);
    std::uint64_t holes = 0;
    std::vector<bool> is_hole(rows * columns);
    for (std::uint64_t row = 0; row < rows; ++row) {
        for (std::uint64_t column = 0; column < columns; ++column) {
            double height = height_at(row, column);
            if (std::isnan(height)) {
                is_hole[geometry.positions.size()] = true;
                ++holes;
                height = 0;
            }
            geometry.positions.push_back(from_y_up(up, position(row, column, height)));
        }
    }
    if (holes != 0)
        content.warnings.push_back(fmt::format("{} {}: the cells around are holes",
                                               counted(holes, "height is", "heights are"), hole));
    for (std::uint64_t row = 0; row + 1 < rows; ++row) {
        for (std::uint64_t column = 0; column + 1 < columns; ++column) {
            const auto a = static_cast<std::uint32_t>(row * columns + column);
            std::uint32_t b = a + 1;
            auto c = static_cast<std::uint32_t>(a + columns);
            const std::uint32_t d = c + 1;
            if (is_mirrored) std::swap(b, c);
            if (is_hole[a] || is_hole[b] || is_hole[c] || is_hole[d]) continue;
            geometry.rest.indices.insert(geometry.rest.indices.end(), {a, c, b, b, c, d});
        }
    }
    return content;
}

UpAxis up_of(const ImportRequest& request) {
    return request.options.z_up ? UpAxis::z : UpAxis::y;
}

/// Metres of EPSG's units of length; 0 for others.
double metres_of(std::uint32_t unit) {
    constexpr std::uint32_t metre = 9001, foot = 9002, survey_foot = 9003;
    return unit == metre ? 1 : unit == foot ? 0.3048 : unit == survey_foot ? 1200.0 / 3937 : 0;
}

}  // namespace

Result<FileContent> read_heights(const ImportRequest& request, const ImportLimits& limits) {
    const NamedBytes& file = request.files.front();
    if (request.files.size() != 1)
        return refuse_array(file.name, "holds heights, which take no file of placements");
    const auto grid = parse_npy(file, limits);
    if (!grid) return tl::unexpected<Error>(grid.error());
    if (grid->shape.size() != 2 || grid->shape[0] < 2 || grid->shape[1] < 2)
        return refuse_array(file.name,
                            "must have shape (rows, columns) of at least two each to be heights");
    if (grid->count > limits.triangles_max / 2)
        return fail(ErrorCode::limit_exceeded,
                    fmt::format("'{}' has {} heights; at most {} are allowed", file.name,
                                grid->count, limits.triangles_max / 2));
    const double spacing = request.options.spacing == 0 ? 1 : request.options.spacing;
    return mesh_of(
        up_of(request), grid->shape[0], grid->shape[1], "NaN", false,
        [&](std::uint64_t row, std::uint64_t column) { return grid->at(row, column); },
        [&](std::uint64_t row, std::uint64_t column, double height) {
            return glm::dvec3(static_cast<double>(column) * spacing, height,
                              static_cast<double>(row) * spacing);
        });
}

Result<FileContent> read_tiff(const ImportRequest& request, const ImportLimits& limits) {
    const auto grid = decode_geotiff(request.files.front().bytes, limits.triangles_max / 2);
    if (!grid) return tl::unexpected(grid.error());
    if (grid->is_in_degrees)
        return fail(ErrorCode::scene_invalid,
                    "is a map in degrees: bring it to metres, for example with gdalwarp -t_srs "
                    "EPSG:32632, which is UTM zone 32 north");
    if (grid->to_map && request.options.spacing != 0)
        return fail(ErrorCode::scene_invalid,
                    "says itself where its heights lie on the map: leave out `spacing`");
    const double spacing = request.options.spacing == 0 ? 1 : request.options.spacing;
    const std::array<double, 6> map =
        grid->to_map.value_or(std::array<double, 6>{0, spacing, 0, 0, 0, -spacing});
    const double unit = grid->unit == 0 ? 1 : metres_of(grid->unit);
    // The option says how long a unit of the map is. Heights have the same, unless the file says
    // otherwise.
    const double metres = request.options.unit != 0 ? 1 : unit == 0 ? 1 : unit;
    const double height_unit = metres_of(grid->height_unit);
    const double map_unit = request.options.unit != 0 ? request.options.unit : metres;
    const double tall = height_unit == 0 ? 1 : height_unit / map_unit;
    FileContent content = mesh_of(
        up_of(request), grid->rows, grid->columns, "not known", map[1] * map[5] > map[2] * map[4],
        [&](std::uint64_t row, std::uint64_t column) {
            return tall * grid->heights[row * grid->columns + column];
        },
        [&](std::uint64_t row, std::uint64_t column, double height) {
            const auto r = static_cast<double>(row), c = static_cast<double>(column);
            // East is +x, and north is -z before the turn.
            return metres * glm::dvec3(map[0] + map[1] * c + map[2] * r, height,
                                       -(map[3] + map[4] * c + map[5] * r));
        });
    content.is_surveyed = grid->to_map.has_value();
    if (unit == 0 && request.options.unit == 0)
        content.warnings.push_back(fmt::format(
            "the map's unit is EPSG:{}; it is taken for metres: say otherwise with `unit`",
            grid->unit));
    if (height_unit == 0 && grid->height_unit != 0)
        content.warnings.push_back(
            fmt::format("the unit of the heights is EPSG:{}; they are taken to have the map's",
                        grid->height_unit));
    if (!grid->to_map && request.options.spacing == 0)
        content.warnings.emplace_back(
            "the TIFF has no place on a map: its heights stand 1 m apart, or `spacing`");
    return content;
}

}  // namespace raynest
