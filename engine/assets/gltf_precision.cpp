#include "engine/assets/gltf_precision.h"

#include "engine/geometry/box.h"

#include <algorithm>
#include <cmath>

namespace raynest::gltf {
namespace {

Matrix translation(double x, double y, double z) {
    return {1, 0, 0, x, 0, 1, 0, y, 0, 0, 1, z};
}

Box bounds_of(const ObjectDescription& object) {
    Box box;
    for (const GeometryDescription& geometry : object.geometries)
        for (const Vec3& point : geometry.positions) box.extend(point);
    return box;
}

double reach_of(const Box& box) {
    return box.is_empty()
               ? 0
               : glm::length(glm::dvec3(glm::max(glm::abs(box.lower), glm::abs(box.upper))));
}

/// Returns how far a 3x4 map may move a point at this distance from zero: by its longest column,
/// and by its translation.
template <class Numbers>
double farthest(const Numbers& m, double reach) {
    const auto column = [&](std::size_t i) {
        return std::hypot(double{m[i]}, double{m[4 + i]}, double{m[8 + i]});
    };
    return std::max({column(0), column(1), column(2)}) * reach + column(3);
}

}  // namespace

void move_world(Model& model, const WorldPoint& origin) {
    if (origin == WorldPoint{}) return;
    std::vector<bool> is_top(model.nodes.size(), true);
    for (const Node& node : model.nodes)
        for (const std::uint32_t child : node.children) is_top[child] = false;
    for (const std::uint32_t root : model.roots) is_top[root] = true;
    const Matrix to_scene = translation(-origin[0], -origin[1], -origin[2]);
    for (std::size_t i = 0; i < model.nodes.size(); ++i)
        if (is_top[i]) model.nodes[i].local = multiply(to_scene, model.nodes[i].local);
}

Placements::Placements(std::span<ObjectDescription> meshes, const WorldPoint& origin)
    : centres_(meshes.size()) {
    for (std::size_t i = 0; i < meshes.size(); ++i) {
        const Box box = bounds_of(meshes[i]);
        const glm::dvec3 centre(glm::vec3((glm::dvec3(box.lower) + glm::dvec3(box.upper)) * 0.5));
        const bool is_far =
            !box.is_empty() && glm::length(centre) > glm::length(glm::dvec3(box.size()));
        reaches_.push_back(reach_of(box));
        if (origin == WorldPoint{} || !is_far) continue;
        centres_[i] = {centre.x, centre.y, centre.z};
        reaches_[i] = glm::length(glm::dvec3(box.size())) / 2;
        for (GeometryDescription& geometry : meshes[i].geometries)
            for (Vec3& point : geometry.positions) point = Vec3(glm::dvec3(point) - centre);
    }
}

void Placements::add(const ObjectDescription& object) {
    double reach = 0;
    for (const InstanceDescription& instance : object.instances)
        reach = std::max(reach, farthest(instance.transform.m, reaches_[instance.object]));
    reaches_.push_back(reach);
    centres_.push_back({});
}

Transform Placements::round(std::uint32_t object, const Matrix& to_parent) {
    const WorldPoint& centre = centres_[object];
    const Matrix exact = centre == WorldPoint{}
                             ? to_parent
                             : multiply(to_parent, translation(centre[0], centre[1], centre[2]));
    const Transform rounded = round_matrix(exact);
    Matrix error{};
    for (std::size_t i = 0; i < error.size(); ++i) error[i] = double{rounded.m[i]} - exact[i];
    const double moved = farthest(error, reaches_[object]);
    if (std::isfinite(moved)) rounding_ = std::max(rounding_, moved);
    return rounded;
}

}  // namespace raynest::gltf
