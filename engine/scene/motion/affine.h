// 3x4 maps in double, which files state: composed down the nodes, rounded once.
#pragma once

#include "engine/math/vec.h"

#include <algorithm>
#include <array>
#include <optional>

namespace raynest {

/// Row-major as Transform.
using Affine = std::array<double, 12>;
inline constexpr Affine identity_affine{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0};

/// Returns translation, quaternion (x y z w) and scale as one map; `rotation` need not be
/// normalised but must not be zero.
Affine from_trs(const double* translation, const double* rotation, const double* scale);
/// Returns the map that applies `inner`, then `outer`.
Affine multiply(const Affine& outer, const Affine& inner);
/// Maps a point, and a direction.
[[nodiscard]] inline glm::dvec3 map_vector(const Affine& m, const glm::dvec3& v) {
    return {m[0] * v.x + m[1] * v.y + m[2] * v.z, m[4] * v.x + m[5] * v.y + m[6] * v.z,
            m[8] * v.x + m[9] * v.y + m[10] * v.z};
}
[[nodiscard]] inline glm::dvec3 map_point(const Affine& m, const glm::dvec3& p) {
    return map_vector(m, p) + glm::dvec3(m[3], m[7], m[11]);
}
/// Returns the same map in double.
[[nodiscard]] inline Affine affine_of(const Transform& transform) {
    Affine made{};
    std::ranges::copy(transform.m, made.begin());
    return made;
}
/// Returns the map back; nothing if it flattens.
std::optional<Affine> invert(const Affine& map);
/// Returns what has been done to an instance that was placed by `before`: the map that leads from
/// there to `now`, in the space that both lead to. Nothing if `now` is `before`, but for rounding,
/// or if that flattens.
std::optional<Affine> change_of(const Affine& before, const Transform& now);
/// Rounds a map to float; entries that do not fit become infinite.
Transform round_affine(const Affine& affine);

}  // namespace raynest
