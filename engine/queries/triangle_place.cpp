#include "engine/queries/triangle_place.h"

#include "engine/bvh/node.h"
#include "engine/geometry/triangle.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstddef>
#include <vector>

namespace raynest {
namespace {

/// Nodes opened for one triangle, at most; a tree of boxes that all contain the point has more.
constexpr int opened_max = 4096;
/// Rounding of a point on a triangle and of its box, relative to its coordinates.
constexpr float slack = 1e-5F;

std::array<Vec3, 3> corners(const SceneView& scene, const GeometryRecord& geometry,
                            std::uint32_t index) {
    const auto* corner = scene.attribute<std::uint32_t>(geometry.indices) + std::size_t{3} * index;
    const auto* position = scene.attribute<Vec3>(geometry.positions);
    return {position[corner[0]], position[corner[1]], position[corner[2]]};
}

void add(const std::array<Vec3, 3>& triangle, AreaSums& sums) {
    Box box;
    for (const Vec3& corner : triangle) box.extend(corner);
    const glm::dvec3 a(triangle[0]);
    sums.triangles +=
        glm::length(glm::cross(glm::dvec3(triangle[1]) - a, glm::dvec3(triangle[2]) - a)) / 2;
    sums.boxes += static_cast<double>(box.half_area());
}

/// Places that are compared with each other at once: 8 MiB of hashes.
constexpr std::size_t places_max = 1U << 20;

/// SplitMix64's mixer (math/random.h).
std::uint64_t mixed(std::uint64_t z) {
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ULL;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBULL;
    return z ^ (z >> 31);
}

/// A hash of where a triangle lies, whatever the order of its corners; no two places among 2^20 are
/// likely to share it. 0 without area.
std::uint64_t place_of(const std::array<Vec3, 3>& triangle) {
    if (triangle[0] == triangle[1] || triangle[1] == triangle[2] || triangle[2] == triangle[0])
        return 0;
    std::uint64_t sum = 0;
    for (const Vec3& corner : triangle) {
        std::uint64_t hash = 0;
        // -0 is 0.
        for (int axis = 0; axis < 3; ++axis)
            hash = mixed(hash + 1 + std::bit_cast<std::uint32_t>(corner[axis] + 0.0F));
        sum += hash;
    }
    return std::max<std::uint64_t>(mixed(sum), 1);
}

bool contains(const Node& node, std::uint32_t slot, const Vec3& point) {
    for (int axis = 0; axis < 3; ++axis) {
        const float room = slack * (std::abs(point[axis]) + 1e-20F);
        if (point[axis] < node.lower[axis][slot] - room ||
            point[axis] > node.upper[axis][slot] + room)
            return false;
    }
    return true;
}

bool holds(const TriangleBlock* blocks, std::uint32_t leaf, std::uint32_t triangle) {
    const TriangleBlock* first = blocks + leaf_first(leaf);
    return std::any_of(first, first + leaf_count(leaf), [&](const TriangleBlock& block) {
        return std::ranges::find(block.triangle, triangle) != std::end(block.triangle);
    });
}

}  // namespace

float box_share(const SceneView& scene, const ObjectRecord& object, std::uint32_t triangle) {
    const GeometryRecord& geometry = scene.geometry_of(object, triangle);
    AreaSums sums;
    add(corners(scene, geometry, triangle - geometry.first_triangle), sums);
    return static_cast<float>(sums.share());
}

AreaSums area_sums(const SceneView& scene, const ObjectRecord& object) {
    AreaSums sums;
    for (std::uint32_t g = 0; g < object.geometry_count; ++g) {
        const GeometryRecord& geometry = scene.geometries[object.first_geometry + g];
        for (std::uint32_t i = 0; i < geometry.triangle_count; ++i)
            add(corners(scene, geometry, i), sums);
    }
    return sums;
}

double triangles_in_one_place(const SceneView& scene, const ObjectRecord& object) {
    std::vector<std::uint64_t> places;
    std::uint64_t skipped = 0;  // bits of a hash that must be 0: all copies of a place share them
    const auto looks_at = [&](std::uint64_t place) { return (place & skipped) == 0; };
    for (std::uint32_t g = 0; g < object.geometry_count; ++g) {
        const GeometryRecord& geometry = scene.geometries[object.first_geometry + g];
        for (std::uint32_t i = 0; i < geometry.triangle_count; ++i) {
            const std::uint64_t place = place_of(corners(scene, geometry, i));
            if (place == 0 || !looks_at(place)) continue;
            places.push_back(place);
            if (places.size() < places_max) continue;
            skipped = 2 * skipped + 1;
            std::erase_if(places, [&](std::uint64_t other) { return !looks_at(other); });
        }
    }
    std::ranges::sort(places);
    double sum = 0;
    for (std::size_t first = 0, last = 0; first < places.size(); first = last) {
        while (last < places.size() && places[last] == places[first]) ++last;
        sum += static_cast<double>(last - first) * static_cast<double>(last - first);
    }
    return places.empty() ? 0 : sum / static_cast<double>(places.size());
}

std::uint32_t tree_depth(const SceneView& scene, const ObjectRecord& object, std::uint32_t triangle,
                         float u, float v) {
    const GeometryRecord& geometry = scene.geometry_of(object, triangle);
    const auto [a, b, c] = corners(scene, geometry, triangle - geometry.first_triangle);
    const Vec3 point = a * (1 - u - v) + b * u + c * v;
    const TriangleBlock* blocks = scene.blocks + object.first_block;

    struct Entry {
        std::uint32_t child;
        std::uint32_t depth;
    };
    // Each node on the way leaves at most seven siblings behind.
    std::array<Entry, 7 * tree_height_max + 8> stack;
    std::size_t size = 0;
    stack[size++] = {object.root, 0};
    for (int opened = 0; size != 0 && opened < opened_max;) {
        const auto [child, depth] = stack[--size];
        if (child == child_empty) continue;
        if (is_leaf(child)) {
            if (kind_of(child) == ChildKind::triangles && holds(blocks, child, triangle))
                return depth;
            continue;
        }
        ++opened;
        const Node& node = scene.nodes[object.first_node + child];
        for (std::uint32_t slot = 0; slot < 8; ++slot)
            if ((node.valid() >> slot & 1U) != 0 && contains(node, slot, point) &&
                size < stack.size())
                stack[size++] = {node.child[slot], depth + 1};
    }
    return no_id;
}

}  // namespace raynest
