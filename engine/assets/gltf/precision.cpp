#include "engine/assets/gltf/precision.h"

#include "engine/geometry/box.h"
#include "engine/scene/precision.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

namespace raynest::gltf {
namespace {

Matrix translation(double x, double y, double z) {
    return {1, 0, 0, x, 0, 1, 0, y, 0, 0, 1, z};
}

/// Distance from zero, in sizes of a mesh, below which half a step of float32 is no notable share
/// of it.
constexpr double far_sizes = 100;

template <class Object, class Visit>
void for_each_vertex(Object& object, const Visit& visit) {
    for (auto& geometry : object.geometries)
        for (auto& point : geometry.positions) visit(point);
}

Box bounds_of(const ObjectDescription& object) {
    Box box;
    for_each_vertex(object, [&](const Vec3& point) { box.extend(point); });
    return box;
}

double reach_of(const Box& box) {
    return glm::length(glm::dvec3(glm::max(glm::abs(box.lower), glm::abs(box.upper))));
}

template <class Numbers>
double longest_column(const Numbers& m) {
    const auto column = [&](std::size_t i) {
        return std::hypot(double{m[i]}, double{m[4 + i]}, double{m[8 + i]});
    };
    return std::max({column(0), column(1), column(2)});
}

/// Returns how far a 3x4 map may move a point at this distance from zero: by its longest column,
/// and by its translation.
template <class Numbers>
double farthest(const Numbers& m, double reach) {
    return longest_column(m) * reach + std::hypot(double{m[3]}, double{m[7]}, double{m[11]});
}

/// Returns the corners of a box where a 3x4 map puts them.
template <class Numbers>
std::array<glm::dvec3, 8> corners_of(const glm::dvec3& lower, const glm::dvec3& upper,
                                     const Numbers& m) {
    std::array<glm::dvec3, 8> corners{};
    for (std::size_t i = 0; i < corners.size(); ++i) {
        const glm::dvec3 p((i & 1U) != 0 ? upper.x : lower.x, (i & 2U) != 0 ? upper.y : lower.y,
                           (i & 4U) != 0 ? upper.z : lower.z);
        for (std::size_t row = 0; row < 3; ++row)
            corners[i][static_cast<int>(row)] =
                double{m[4 * row]} * p.x + double{m[4 * row + 1]} * p.y +
                double{m[4 * row + 2]} * p.z + double{m[4 * row + 3]};
    }
    return corners;
}

}  // namespace

Matrix world_to_scene(UpAxis up, const WorldPoint& origin) {
    Matrix to_scene = translation(-origin[0], -origin[1], -origin[2]);
    const glm::dmat4 turn = turn_of(UpAxis::y, up);
    for (int row = 0; row < 3; ++row)
        for (int column = 0; column < 3; ++column)
            to_scene[static_cast<std::size_t>(4 * row + column)] = turn[column][row];
    return to_scene;
}

void move_world(Model& model, const WorldPoint& origin) {
    if (origin == WorldPoint{} && model.up == UpAxis::y) return;
    std::vector<bool> is_top(model.nodes.size(), true);
    for (const Node& node : model.nodes)
        for (const std::uint32_t child : node.children) is_top[child] = false;
    for (const std::uint32_t root : model.roots) is_top[root] = true;
    const Matrix to_scene = world_to_scene(model.up, origin);
    for (std::size_t i = 0; i < model.nodes.size(); ++i)
        if (is_top[i]) model.nodes[i].local = multiply(to_scene, model.nodes[i].local);
}

Placements::Placements(std::span<ObjectDescription> meshes, const WorldPoint& origin) {
    for (ObjectDescription& mesh : meshes) {
        const Box box = bounds_of(mesh);
        Extent& extent = extents_.emplace_back();
        if (box.is_empty()) continue;
        const double size = glm::length(glm::dvec3(box.size()));
        extent.reach = reach_of(box);
        extent.lower = glm::dvec3(box.lower), extent.upper = glm::dvec3(box.upper);
        if (extent.reach > far_sizes * size)
            for_each_vertex(mesh, [&](const Vec3& point) {
                extent.half_step = std::max(extent.half_step, half_step(point));
            });
        const glm::dvec3 centre(glm::vec3((extent.lower + extent.upper) * 0.5));
        if (origin == WorldPoint{} || !(glm::length(centre) > size)) continue;
        extent.centre = {centre.x, centre.y, centre.z};
        extent.reach = size / 2;
        extent.lower -= centre, extent.upper -= centre;
        for_each_vertex(mesh, [&](Vec3& point) { point = Vec3(glm::dvec3(point) - centre); });
    }
}

void Placements::add(const ObjectDescription& object) {
    Extent extent;
    glm::dvec3 lower(std::numeric_limits<double>::infinity()), upper(-lower);
    for (const InstanceDescription& instance : object.instances) {
        const Extent& child = extents_[instance.object];
        const auto& m = instance.transform.m;
        extent.reach = std::max(extent.reach, farthest(m, child.reach));
        extent.half_step = std::max(extent.half_step, longest_column(m) * child.half_step);
        for (const glm::dvec3& corner : corners_of(child.lower, child.upper, m))
            lower = glm::min(lower, corner), upper = glm::max(upper, corner);
    }
    if (!object.instances.empty()) extent.lower = lower, extent.upper = upper;
    extents_.push_back(extent);
}

Transform Placements::round(std::uint32_t object, const Matrix& to_parent) {
    const Matrix exact = exact_matrix(object, to_parent);
    const Transform rounded = round_affine(exact);
    Matrix error{};
    for (std::size_t i = 0; i < error.size(); ++i) error[i] = double{rounded.m[i]} - exact[i];
    const double moved = farthest(error, extents_[object].reach);
    if (std::isfinite(moved)) rounding_ = std::max(rounding_, moved);
    return rounded;
}

void Placements::place_in_scene(std::uint32_t object, const Matrix& to_scene) {
    const Extent& extent = extents_[object];
    const Matrix exact = exact_matrix(object, to_scene);
    for (const glm::dvec3& corner : corners_of(extent.lower, extent.upper, exact)) {
        const double moved = glm::length(glm::dvec3(glm::vec3(corner)) - corner);
        if (std::isfinite(moved)) rounding_ = std::max(rounding_, moved);
    }
    const double off = longest_column(exact) * extent.half_step;
    if (std::isfinite(off)) file_rounding_ = std::max(file_rounding_, off);
}

Matrix Placements::exact_matrix(std::uint32_t object, const Matrix& to_parent) const {
    const WorldPoint& centre = extents_[object].centre;
    if (centre == WorldPoint{}) return to_parent;
    return multiply(to_parent, translation(centre[0], centre[1], centre[2]));
}

}  // namespace raynest::gltf
