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
    const F scaled_u = flip_sign(at_b, det);
    const F scaled_v = flip_sign(at_c, det);
    const std::uint32_t mask = less(zero, scale) & less_equal(zero, flip_sign(at_a, det)) &
                               less_equal(zero, scaled_u) & less_equal(zero, scaled_v);
    if (mask == 0) return hits;

    const auto own = own_interval<N>(slabs_of(ray), triangles);
    // The signs above decide; t, u and v come from the edges themselves. A mean of the sheared
    // corners would be off by the last bit of their distance: 4 cm on a floor of 2 m x 10 km.
    // With the normal n and the ray in its own frame, where the direction is (-to_x, -to_y, 1):
    //   t = n (a - o) / n d       u = e2 ((a - o) x d) / n d       v = -e1 ((a - o) x d) / n d
    const auto edge_to = [&](int k) RAYNEST_INLINE_LAMBDA {
        const auto along = [&](std::uint32_t axis) RAYNEST_INLINE_LAMBDA {
            return triangles.template coordinate<N>(k, axis) -
                   triangles.template coordinate<N>(0, axis);
        };
        return Corner{along(shear.x), along(shear.y), along(shear.z)};
    };
    const auto from_origin = [&](std::uint32_t axis, const auto& origin) RAYNEST_INLINE_LAMBDA {
        return triangles.template coordinate<N>(0, axis) - in_lanes<N>(origin);
    };
    const F to_x = in_lanes<N>(shear.to_x);
    const F to_y = in_lanes<N>(shear.to_y);
    const Corner e1 = edge_to(1);
    const Corner e2 = edge_to(2);
    const Corner n{e1.y * e2.z - e1.z * e2.y, e1.z * e2.x - e1.x * e2.z, edge(e1, e2)};
    const F facing = fused(n.x, to_x, fused(n.y, to_y, zero - n.z));  // -n d
    // One division: three would cost as much as the rest.
    const F inverse = F::splat(-1) / facing;
    const F x = from_origin(shear.x, shear.origin_x);
    const F y = from_origin(shear.y, shear.origin_y);
    const F turn = y * to_x - x * to_y;  // z of (a - o) x d; its x and y are a.y and -a.x
    // n is divided first: its product with a third length would overflow from 10^12 m on, and
    // vanish below 10^-13 m.
    F depth = fused(n.x * inverse, x, fused(n.y * inverse, y, n.z * inverse * a.z));
    hits.u = fused(e2.z, turn, e2.x * a.y - e2.y * a.x) * inverse;
    hits.v = (e1.y * a.x - e1.x * a.y - e1.z * turn) * inverse;
    // n d may vanish. Otherwise it also tells the side: where it differs from det, a long triangle is
    // met far from its corners, and det consists of their rounding errors.
    F side = facing;
    const F most = F::splat(std::numeric_limits<float>::max());
    const std::uint32_t usable = less_equal(flip_sign(inverse, inverse), most);
    if ((mask & ~usable) != 0) [[unlikely]] {
        const F share = F::splat(1) / scale;
        const F w = flip_sign(at_a, det) * share;
        const F u = scaled_u * share;
        const F v = scaled_v * share;
        hits.u = select(usable, hits.u, u);
        hits.v = select(usable, hits.v, v);
        const F mean = fused(w, a.z, fused(u, b.z, v * c.z));
        depth = select(usable, depth, mean);
        side = select(usable, facing, det);
    }
    hits.u = minimum(maximum(hits.u, zero), F::splat(1));
    hits.v = minimum(maximum(hits.v, zero), F::splat(1) - hits.u);
    const F t = depth * in_lanes<N>(shear.scale);
    hits.t = minimum(maximum(t, own.near), own.far);
    hits.mask = mask & less_equal(own.near, own.far) & less(in_lanes<N>(ray.tmin), hits.t) &
                less_equal(hits.t, in_lanes<N>(ray.tmax));
    hits.front = less(zero, side * in_lanes<N>(shear.scale));
    return hits;
}

template <class R>
RAYNEST_INLINE auto intersect(const R& ray, const Triangle& triangle) {
    return intersect(ray, TriangleRef(triangle));
}

}  // namespace raynest
