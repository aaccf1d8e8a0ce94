// Ray against triangle: Moeller, Trumbore, "Fast, minimum storage ray/triangle intersection"
// (1997), one source for one triangle and for a block of eight.
//
// Unlike the original, t is held to the interval in which the ray passes the triangle's own box
// (geometry/slabs.h): what the test calls a hit is then never culled by a box around it, and t of a
// grazing hit is as exact as the box.
#pragma once

#include "engine/geometry/concepts.h"
#include "engine/geometry/intersection.h"
#include "engine/geometry/slabs.h"
#include "engine/geometry/triangle.h"

namespace raynest {

/// One triangle of a plain list, or one lane of a block: what the reference walks.
struct TriangleRef {
    using triangle_tag = void;
    static constexpr int lanes = 1;
    Vec3 v0, v1, v2;
    std::uint32_t prim;
    std::uint32_t geom;

    RAYNEST_INLINE explicit TriangleRef(const Triangle& t)
        : v0(t.v0),
          v1(t.v1),
          v2(t.v2),
          prim(t.prim),
          geom(t.geom) {}
    RAYNEST_INLINE TriangleRef(const TriangleBlock& block, int lane)
        : v0(corner(block, 0, lane)),
          v1(corner(block, 1, lane)),
          v2(corner(block, 2, lane)),
          prim(block.triangle[lane]),
          geom(0) {}

    template <int N>
    [[nodiscard]] RAYNEST_INLINE Lanes3<N> vertex(int k) const {
        return Lanes3<N>::splat(k == 0 ? v0 : k == 1 ? v1 : v2);
    }
    [[nodiscard]] RAYNEST_INLINE std::uint32_t valid() const { return 1; }
    [[nodiscard]] RAYNEST_INLINE std::uint32_t prim_of(int) const { return prim; }
    [[nodiscard]] RAYNEST_INLINE std::uint32_t geom_of(int) const { return geom; }

private:
    RAYNEST_INLINE static Vec3 corner(const TriangleBlock& block, int k, int lane) {
        return {block.vertex[k][0][lane], block.vertex[k][1][lane], block.vertex[k][2][lane]};
    }
};

/// A block of a leaf. `first` tells the first block of its leaf from the following ones.
struct Triangles8 {
    using triangle_tag = void;
    static constexpr int lanes = 8;
    const TriangleBlock* block;
    bool first;

    template <int N>
    [[nodiscard]] RAYNEST_INLINE Lanes3<N> vertex(int k) const {
        return {Lanes<N>::load(block->vertex[k][0]), Lanes<N>::load(block->vertex[k][1]),
                Lanes<N>::load(block->vertex[k][2])};
    }
    /// Lanes that hold a triangle; the others are padding.
    [[nodiscard]] std::uint32_t valid() const {
        std::uint32_t mask = 0;
        for (int lane = 0; lane < 8; ++lane) {
            mask |= static_cast<std::uint32_t>(block->triangle[lane] != no_id) << lane;
        }
        return mask;
    }
    [[nodiscard]] RAYNEST_INLINE std::uint32_t prim_of(int lane) const {
        return block->triangle[lane];
    }
    [[nodiscard]] RAYNEST_INLINE std::uint32_t geom_of(int) const { return 0; }
};

/// Both sides are hit. The interval (tmin, tmax] is exact. Degenerate triangles, padding and NaN
/// have no candidate.
template <class R, TriangleLike T>
requires(requires { T::lanes; }) RAYNEST_INLINE auto intersect(const R& ray, const T& triangles) {
    constexpr int N = T::lanes;
    using F = Lanes<N>;
    Hits<T, N> hits{0, 0, F::splat(0), F::splat(0), F::splat(0), triangles};

    const auto v0 = triangles.template vertex<N>(0);
    const auto v1 = triangles.template vertex<N>(1);
    const auto v2 = triangles.template vertex<N>(2);
    const auto e1 = v1 - v0;
    const auto e2 = v2 - v0;
    const auto direction = Lanes3<N>::splat(ray.direction);
    const auto p = cross(direction, e2);
    const F det = dot(e1, p);
    const auto s = Lanes3<N>::splat(ray.origin) - v0;
    const auto q = cross(s, e1);

    // All scaled by |det|: no division before a lane survives.
    const F zero = F::splat(0);
    const F scale = flip_sign(det, det);
    const F u = flip_sign(dot(s, p), det);
    const F v = flip_sign(dot(direction, q), det);
    const std::uint32_t mask =
        less(zero, scale) & less_equal(zero, u) & less_equal(zero, v) & less_equal(u + v, scale);
    if (mask == 0) return hits;

    const auto own = own_interval<N>(slabs_of<N>(ray), v0, v1, v2);
    const F t = flip_sign(dot(e2, q), det) / scale;
    hits.t = minimum(maximum(t, own.near), own.far);
    hits.u = u / scale;
    hits.v = v / scale;
    hits.mask = mask & less_equal(own.near, own.far) & less(F::splat(ray.tmin), hits.t) &
                less_equal(hits.t, F::splat(ray.tmax));
    hits.front = less(zero, det);
    return hits;
}

template <class R>
RAYNEST_INLINE auto intersect(const R& ray, const Triangle& triangle) {
    return intersect(ray, TriangleRef(triangle));
}

}  // namespace raynest
