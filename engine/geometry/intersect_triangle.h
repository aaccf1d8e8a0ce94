// Ray against triangle, watertight: Woop, Benthin, Wald, "Watertight ray/triangle intersection"
// (2013), one source for one triangle and for a block of eight.
//
// The vertices are sheared into the ray's own frame, where the ray is the z axis; three edge
// functions of the plane then say on which side of each edge it passes. No ray slips between two
// triangles that share an edge or a vertex: a shared vertex lands on the same bits for both, and
// the edge function of a shared edge is the exact negative for the other side, because products are
// rounded one by one (no fma here). Rounding is monotone, so a sign is never wrong, it only becomes
// 0; 0 counts as inside for both sides, which is why the paper's second look in double precision is
// not needed.
//
// Unlike the original, t is held to the interval in which the ray passes the triangle's own box
// (geometry/slabs.h): what the test calls a hit is then never culled by a box around it, and t of a
// grazing hit is as exact as the box.
#pragma once

#include "engine/geometry/concepts.h"
#include "engine/geometry/intersection.h"
#include "engine/geometry/shear.h"
#include "engine/geometry/slabs.h"
#include "engine/geometry/triangle.h"

#include <array>
#include <bit>
#include <cstdint>
#include <limits>

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

    /// Returns a coordinate of corner k for all lanes.
    template <int N>
    [[nodiscard]] RAYNEST_INLINE Lanes<N> coordinate(int k, std::uint32_t axis) const {
        const Vec3& vertex = k == 0 ? v0 : k == 1 ? v1 : v2;
        return Lanes<N>::splat(std::bit_cast<std::array<float, 3>>(vertex)[axis]);
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
    [[nodiscard]] RAYNEST_INLINE Lanes<N> coordinate(int k, std::uint32_t axis) const {
        // One address per axis: nine of them do not fit in the registers of a traversal.
        return Lanes<N>::load(block->vertex[0][axis] + 24 * k);
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
    Hits<T, N> hits(triangles);

    const auto& shear = shear_of(ray);
    struct Corner {
        F x, y, z;
    };
    const auto corner = [&](int k) RAYNEST_INLINE_LAMBDA {
        const auto from = [&](std::uint32_t axis, const auto& origin) RAYNEST_INLINE_LAMBDA {
            return triangles.template coordinate<N>(k, axis) - in_lanes<N>(origin);
        };
        const F z = from(shear.z, shear.origin_z);
        return Corner{fused(in_lanes<N>(shear.to_x), z, from(shear.x, shear.origin_x)),
                      fused(in_lanes<N>(shear.to_y), z, from(shear.y, shear.origin_y)), z};
    };
    const auto edge = [](const Corner& p, const Corner& q)
                          RAYNEST_INLINE_LAMBDA { return p.x * q.y - p.y * q.x; };
    const Corner a = corner(0);
    const Corner b = corner(1);
    const Corner c = corner(2);
    const F at_a = edge(c, b);
    const F at_b = edge(a, c);
    const F at_c = edge(b, a);
    const F det = at_a + at_b + at_c;

    // Barycentric coordinates scaled by |det|: no division before a lane survives.
    const F zero = F::splat(0);
    const F scale = flip_sign(det, det);
    const F u = flip_sign(at_b, det);
    const F v = flip_sign(at_c, det);
    const std::uint32_t mask = less(zero, scale) & less_equal(zero, flip_sign(at_a, det)) &
                               less_equal(zero, u) & less_equal(zero, v);
    if (mask == 0) return hits;

    const auto own = own_interval<N>(slabs_of(ray), triangles);
    const F distance = fused(at_a, a.z, fused(at_b, b.z, at_c * c.z));
    const F inverse = F::splat(1) / scale;  // one division: three would cost as much as the rest
    const F along = flip_sign(distance, det) * in_lanes<N>(shear.scale);
    F t = along * inverse;
    hits.u = u * inverse;
    hits.v = v * inverse;
    // The product of three lengths overflows from 10^12 on; divided first it does not, but takes
    // longer.
    const F most = F::splat(std::numeric_limits<float>::max());
    const std::uint32_t finite = less_equal(flip_sign(along, along), most);
    if ((mask & ~finite) != 0) [[unlikely]] {
        const F w = flip_sign(at_a, det) * inverse;
        const F mean = fused(w, a.z, fused(hits.u, b.z, hits.v * c.z));
        t = select(finite, t, mean * in_lanes<N>(shear.scale));
    }
    hits.t = minimum(maximum(t, own.near), own.far);
    hits.mask = mask & less_equal(own.near, own.far) & less(in_lanes<N>(ray.tmin), hits.t) &
                less_equal(hits.t, in_lanes<N>(ray.tmax));
    hits.front = less(zero, det * in_lanes<N>(shear.scale));
    return hits;
}

template <class R>
RAYNEST_INLINE auto intersect(const R& ray, const Triangle& triangle) {
    return intersect(ray, TriangleRef(triangle));
}

}  // namespace raynest
