#include "engine/scene/edits/deform.h"

#include "engine/bvh/node.h"
#include "engine/geometry/triangle.h"
#include "engine/scene/precision.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_reduce.h>

#include <algorithm>
#include <cstddef>
#include <functional>
#include <vector>

namespace raynest {
namespace {

using Part = tbb::blocked_range<std::size_t>;
constexpr std::size_t part_items = 1 << 12;

std::int64_t degenerate(const GeometryRecord& geometry, const Vec3* positions,
                        const std::uint32_t* indices) {
    return tbb::parallel_reduce(
        Part(0, geometry.triangle_count, part_items), std::int64_t{0},
        [&](const Part& part, std::int64_t count) {
            for (std::size_t i = part.begin(); i < part.end(); ++i) {
                const std::uint32_t* const corner = indices + 3 * i;
                count +=
                    is_degenerate(positions[corner[0]], positions[corner[1]], positions[corner[2]])
                        ? 1
                        : 0;
            }
            return count;
        },
        std::plus<>());
}

/// Takes the first `count` elements away, or none from an empty list.
template <class T>
std::span<const T> take(std::span<const T>& list, std::size_t count) {
    const auto first = list.first(std::min(count, list.size()));
    list = list.subspan(first.size());
    return first;
}

/// The sum of the triangles' normals at each vertex, by area.
void make_normals(const GeometryRecord& geometry, std::span<const Vec3> positions,
                  const std::uint32_t* indices, Vec3* normals) {
    std::vector<glm::dvec3> sums(positions.size(), glm::dvec3(0));
    for (std::size_t i = 0; i < geometry.triangle_count; ++i) {
        const std::uint32_t* const corner = indices + 3 * i;
        const glm::dvec3 v0(positions[corner[0]]);
        const glm::dvec3 normal = glm::cross(glm::dvec3(positions[corner[1]]) - v0,
                                             glm::dvec3(positions[corner[2]]) - v0);
        for (std::size_t k = 0; k < 3; ++k) sums[corner[k]] += normal;
    }
    for (std::size_t i = 0; i < positions.size(); ++i) {
        const double length = glm::length(sums[i]);
        if (length > 0) normals[i] = Vec3(sums[i] / length);  // else it keeps the one that it had
    }
}

}  // namespace

std::uint64_t vertex_count(const SceneView& view, const ObjectRecord& object) {
    std::uint64_t count = 0;
    for (std::uint32_t i = 0; i < object.geometry_count; ++i)
        count += view.geometries[object.first_geometry + i].vertex_count;
    return count;
}

std::int64_t deform(EditedArena& arena, const ObjectRecord& object, NewVertices vertices) {
    const SceneView& view = arena.view();
    std::int64_t grown = 0;
    std::vector<const Vec3*> moved;  // per geometry
    for (std::uint32_t g = 0; g < object.geometry_count; ++g) {
        const std::uint32_t index = object.first_geometry + g;
        const GeometryRecord& geometry = view.geometries[index];
        const auto now = take(vertices.positions, geometry.vertex_count);
        const auto new_normals = take(vertices.normals, geometry.vertex_count);
        const auto new_tangents = take(vertices.tangents, geometry.vertex_count);
        moved.push_back(now.data());
        if (now.empty() || geometry.triangle_count == 0) continue;
        const auto* const indices = view.attribute<std::uint32_t>(geometry.indices);
        const std::span<Vec3> positions =
            arena.attribute<Vec3>(geometry.positions, geometry.vertex_count);
        grown += degenerate(geometry, now.data(), indices) -
                 degenerate(geometry, positions.data(), indices);
        std::ranges::copy(now, positions.begin());
        arena.touch_all(positions);
        const GeometryShading& shading = arena.geometry_shading(index);
        if (shading.normals == no_offset) continue;
        const std::span<Vec3> normals =
            arena.attribute<Vec3>(shading.normals, geometry.vertex_count);
        if (new_normals.empty())
            make_normals(geometry, now, indices, normals.data());
        else
            std::ranges::copy(new_normals, normals.begin());
        arena.touch_all(normals);
        if (shading.tangents == no_offset || new_tangents.empty()) continue;
        const std::span<Vec4> tangents =
            arena.attribute<Vec4>(shading.tangents, geometry.vertex_count);
        std::ranges::copy(new_tangents, tangents.begin());
        arena.touch_all(tangents);
    }

    const std::span<TriangleBlock> blocks = arena.blocks(object);
    tbb::parallel_for(Part(0, blocks.size(), part_items / 8), [&](const Part& part) {
        for (std::size_t b = part.begin(); b < part.end(); ++b) {
            TriangleBlock& block = blocks[b];
            for (std::size_t lane = 0; lane < 8; ++lane) {
                if (block.triangle[lane] == no_id) continue;
                const GeometryRecord& geometry = view.geometry_of(object, block.triangle[lane]);
                const auto* const corner = view.attribute<std::uint32_t>(geometry.indices) +
                                           3 * (block.triangle[lane] - geometry.first_triangle);
                const Vec3* const positions = moved[static_cast<std::size_t>(
                    &geometry - view.geometries -
                    static_cast<std::ptrdiff_t>(object.first_geometry))];
                for (std::size_t k = 0; k < 3; ++k)
                    for (int axis = 0; axis < 3; ++axis)
                        block.vertex[k][axis][lane] = positions[corner[k]][axis];
            }
        }
    });
    arena.touch_all(blocks);
    return grown;
}

Box box_of_leaf(const SceneView& view, const ObjectRecord& object, std::uint32_t leaf) {
    Box box;
    const TriangleBlock* const first = view.blocks + object.first_block + leaf_first(leaf);
    for (const TriangleBlock* block = first; block != first + leaf_count(leaf); ++block)
        for (std::size_t lane = 0; lane < 8; ++lane) {
            if (block->triangle[lane] == no_id) continue;
            for (const auto& corner : block->vertex)
                box.extend(Vec3(corner[0][lane], corner[1][lane], corner[2][lane]));
        }
    return box;
}

}  // namespace raynest
