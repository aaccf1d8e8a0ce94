// Affine maps in double, for computations that end in a Transform.
#pragma once

#include "engine/math/vec.h"

#include <array>
#include <cstddef>

namespace raynest {

/// Its fourth row is 0 0 0 1.
using Matrix = glm::dmat4;

inline Matrix matrix_of(const Transform& transform) {
    Matrix made(1);
    for (int i = 0; i < 12; ++i)
        made[i % 4][i / 4] = static_cast<double>(transform.m[static_cast<std::size_t>(i)]);
    return made;
}

/// Rounds to float.
inline Transform transform_of(const Matrix& matrix) {
    Transform made;
    for (int i = 0; i < 12; ++i)
        made.m[static_cast<std::size_t>(i)] = static_cast<float>(matrix[i % 4][i / 4]);
    return made;
}

inline Matrix translation_by(const std::array<double, 3>& offset) {
    Matrix made(1);
    for (int i = 0; i < 3; ++i) made[3][i] = offset[static_cast<std::size_t>(i)];
    return made;
}

}  // namespace raynest
