// Vectors and affine 3x4 transforms: the only header that includes GLM for the engine.
//
// Matrices are 3x4, row-major, object-to-world. Transforms of points write every fma in a fixed
// order: the traversal, the reference and the CUDA pack apply the same chain of transforms and must
// get the same bits.
#pragma once

#include <glm/glm.hpp>

#include <algorithm>
#include <array>
#include <cmath>

// RAYNEST_FN: marks functions that kernels call; nvcc compiles them for the GPU, too.
// RAYNEST_NOINLINE: marks code that few rays need, to keep the rest short. On a GPU a call would
// move the ray from registers to memory.
#ifdef __CUDACC__
#define RAYNEST_FN __host__ __device__
#define RAYNEST_NOINLINE RAYNEST_FN
#else
#define RAYNEST_FN
#define RAYNEST_NOINLINE [[gnu::noinline]]
#endif
/// Marks the functions that kernels consist of: a call left over would cost more than its body.
#define RAYNEST_INLINE [[gnu::always_inline]] RAYNEST_FN inline
/// Marks a lambda likewise, after its parameters. GCC stops inlining once a unit has grown by its
/// limit, which a pack's unit does: a call left over inside the triangle test took 2 to 20 %.
#define RAYNEST_INLINE_LAMBDA __attribute__((always_inline))

namespace raynest {

using Vec2 = glm::vec2;
using Vec3 = glm::vec3;
using Vec4 = glm::vec4;
static_assert(sizeof(Vec3) == 12 && sizeof(Vec2) == 8,
              "do not define GLM_FORCE_DEFAULT_ALIGNED_GENTYPES");

/// Returns a*b + c with one rounding if the target has FMA; on x86-64-v2 multiplies, then adds, as
/// Highway's MulAdd does there. So v2 needs a reference of its own.
RAYNEST_INLINE float fused(float a, float b, float c) {
#if defined(__CUDA_ARCH__)
    return __fmaf_rn(a, b, c);
#elif defined(__FMA__)
    return __builtin_fmaf(a, b, c);
#else
    return a * b + c;
#endif
}

/// Returns origin + t * direction.
RAYNEST_INLINE Vec3 point_along(const Vec3& origin, const Vec3& direction, float t) {
    return {fused(t, direction.x, origin.x), fused(t, direction.y, origin.y),
            fused(t, direction.z, origin.z)};
}

/// Returns the largest absolute value of three.
RAYNEST_INLINE float largest_component(const Vec3& v) {
    return std::max(std::max(std::abs(v.x), std::abs(v.y)), std::abs(v.z));
}

/// Rows of a 3x4 affine map; row r is (m[4r], m[4r+1], m[4r+2] | m[4r+3]).
struct Transform {
    std::array<float, 12> m{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0};

    /// Maps a point. Same bits on v3, v4 and CUDA.
    RAYNEST_INLINE Vec3 point(const Vec3& p) const {
        return {fused(m[0], p.x, fused(m[1], p.y, fused(m[2], p.z, m[3]))),
                fused(m[4], p.x, fused(m[5], p.y, fused(m[6], p.z, m[7]))),
                fused(m[8], p.x, fused(m[9], p.y, fused(m[10], p.z, m[11])))};
    }

    /// Maps a direction: no translation, no renormalising, so t means the same at every level.
    RAYNEST_INLINE Vec3 direction(const Vec3& d) const {
        return {fused(m[0], d.x, fused(m[1], d.y, m[2] * d.z)),
                fused(m[4], d.x, fused(m[5], d.y, m[6] * d.z)),
                fused(m[8], d.x, fused(m[9], d.y, m[10] * d.z))};
    }

    bool operator==(const Transform&) const = default;
};
static_assert(sizeof(Transform) == 48);

/// A Transform by columns: column c is (m[3c], m[3c+1], m[3c+2]), and the last one is the
/// translation. So one column at a time is applied to all rows (bvh/visit_primitive.h).
struct ColumnTransform {
    std::array<float, 12> m{1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0};

    bool operator==(const ColumnTransform&) const = default;
};
static_assert(sizeof(ColumnTransform) == sizeof(Transform));

ColumnTransform by_columns(const Transform& transform);
Transform by_rows(const ColumnTransform& transform);

/// Returns the map that applies `inner` first, then `outer`. Computed in double, rounded once.
Transform compose(const Transform& outer, const Transform& inner);

/// Computes the inverse in double. If the transform is singular, returns false and an all-zero 3x3
/// part: the determinant is zero or not finite, or the inverse overflows a float.
bool invert(const Transform& transform, Transform& inverse);

/// Returns the condition number of the 3x3 part in the 2-norm (largest over smallest singular
/// value), >= 1. It bounds how much a rounding error of an instance's ray grows on the way back to
/// its parent.
float condition(const Transform& transform);

}  // namespace raynest
