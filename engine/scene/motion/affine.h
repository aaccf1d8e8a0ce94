// 3x4 maps in double, which files state: composed down the nodes, rounded once.
#pragma once

#include "engine/math/vec.h"

#include <array>

namespace raynest {

/// Row-major as Transform.
using Affine = std::array<double, 12>;
inline constexpr Affine identity_affine{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0};

/// Returns translation, quaternion (x y z w) and scale as one map; `rotation` need not be
/// normalised but must not be zero.
Affine from_trs(const double* translation, const double* rotation, const double* scale);
/// Returns the map that applies `inner`, then `outer`.
Affine multiply(const Affine& outer, const Affine& inner);
/// Rounds a map to float; entries that do not fit become infinite.
Transform round_affine(const Affine& affine);

}  // namespace raynest
