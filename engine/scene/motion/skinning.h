// How joints and targets move a vertex, for files that are read and for scenes that play.
#pragma once

#include "engine/math/vec.h"
#include "engine/scene/motion/affine.h"

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <span>

namespace raynest {

/// Returns the direction of v; zero where it has none.
[[nodiscard]] inline Vec3 unit_vector(const glm::dvec3& v) {
    const double length = glm::length(v);
    return length > 0 && std::isfinite(length) ? Vec3(v / length) : Vec3(0);
}

/// Adds what a target adds at this weight.
inline void add_weighted(std::span<float> values, float weight, const float* differences) {
    for (std::size_t i = 0; i < values.size(); ++i) values[i] += weight * differences[i];
}

/// Returns a normal or tangent after its targets.
[[nodiscard]] inline Vec3 bent(const Vec3& v, const float* difference) {
    return unit_vector(glm::dvec3(v) + glm::dvec3(difference[0], difference[1], difference[2]));
}

/// Returns the map of a vertex: its joints' maps, by their weights.
///
/// Weights are divided by their sum, as in three.js and Blender: glTF requires sums of 1, and an
/// error of 1/255 would move a vertex by that share of its distance from the scene's origin. A
/// vertex whose weights are all 0 follows its first joint, as in three.js.
[[nodiscard]] inline Affine blend_joints(std::span<const Affine> maps, const std::uint32_t* joints,
                                         const float* weights, std::size_t count) {
    Affine blended{};
    double total = 0;
    const auto follow = [&](std::uint32_t joint, double weight) {
        const Affine& m = maps[joint];
        for (std::size_t i = 0; i < blended.size(); ++i) blended[i] += weight * m[i];
        total += weight;
    };
    for (std::size_t i = 0; i < count; ++i)
        if (weights[i] > 0) follow(joints[i], weights[i]);
    if (total == 0) follow(joints[0], 1);
    for (double& x : blended) x /= total;
    return blended;
}

/// Moves a vertex; its normal and tangent may be null.
///
/// The cofactors of a map are its inverse transpose times its determinant: they exist for a map
/// that flattens, too. Where a map mirrors, corners wind the other way round, and shading turns the
/// normal and the tangent of the side that it sees: so both change their sign here.
inline void move_vertex(const Affine& map, Vec3& position, Vec3* normal, Vec4* tangent) {
    const auto column = [&](std::size_t c) { return glm::dvec3(map[c], map[4 + c], map[8 + c]); };
    const glm::dvec3 x = column(0), y = column(1), z = column(2);
    const auto linear = [&](const glm::dvec3& p) { return x * p.x + y * p.y + z * p.z; };
    position = Vec3(linear(glm::dvec3(position)) + column(3));
    if (normal != nullptr) {
        const Vec3 n = *normal;
        *normal = unit_vector(static_cast<double>(n.x) * glm::cross(y, z) +
                              static_cast<double>(n.y) * glm::cross(z, x) +
                              static_cast<double>(n.z) * glm::cross(x, y));
    }
    if (tangent != nullptr) {
        const double side = glm::dot(glm::cross(x, y), z) < 0 ? -1 : 1;
        *tangent = Vec4(unit_vector(side * linear(glm::dvec3(*tangent))), tangent->w);
    }
}

}  // namespace raynest
