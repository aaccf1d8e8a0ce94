// The result of intersect(): candidate lanes, and keep_if(), by which an intersector removes some
// of them.
#pragma once

#include "engine/geometry/box.h"
#include "engine/geometry/ray_view.h"
#include "engine/math/lanes.h"

#include <cstddef>
#include <cstdint>

namespace raynest {

/// One candidate, as keep_if hands it to an intersector.
struct Surface {
    float t, u, v;       ///< hit = (1-u-v) v0 + u v1 + v v2
    std::uint32_t prim;  ///< flat triangle index in the object, or the caller's id in a list
    std::uint32_t geom;  ///< the caller's id in a list of triangles; 0 in a tree
    int lane;
    bool front;  ///< the ray meets the side that the normal points to
};

/// Candidates with tmin < t <= tmax, one bit each. In a triangle block a lane is a triangle; for
/// one primitive lane k is its k-th hit, nearest first.
template <class P, int N>
struct Hits {
    static constexpr int lanes = N;
    static constexpr std::size_t lane_count = N;
    std::uint32_t mask = 0;
    std::uint32_t front = 0;  ///< lanes that were hit from the front
    Lanes<N> t, u, v;         ///< to be read in the lanes of `mask` only
    P primitive;              ///< a view, or a reference to the primitive

    /// No candidate yet. The lanes stay unset: filling them would cost stores for every block.
    RAYNEST_INLINE explicit Hits(const P& tested) : primitive(tested) {}

    /// Removes candidates that `keep(const Surface&)` refuses. Called for every candidate, in no
    /// order that may be relied on; a candidate may turn out to lie behind another one.
    template <class Keep>
    RAYNEST_INLINE void keep_if(Keep&& keep) {
        if (mask == 0) [[likely]]
            return;
        alignas(32) float ts[lane_count];
        alignas(32) float us[lane_count];
        alignas(32) float vs[lane_count];
        t.store(ts);
        u.store(us);
        v.store(vs);
        for_each_lane<N>(mask, [&](int lane) RAYNEST_INLINE_LAMBDA {
            const Surface surface{ts[lane],
                                  us[lane],
                                  vs[lane],
                                  primitive.prim_of(lane),
                                  primitive.geom_of(lane),
                                  lane,
                                  (front >> lane & 1U) != 0};
            if (!keep(surface)) mask &= ~(1U << lane);
        });
    }
};

/// One entered box, as keep_if hands it to an intersector: in the space of the level, as the ray
/// is.
struct EnteredBox {
    Box box;
    float near;  ///< where the ray enters; t, so comparable at every level
};

/// Boxes that the ray enters before tmax, and where.
template <class B, int N>
struct Spans {
    static constexpr int lanes = N;
    static constexpr std::size_t lane_count = N;
    std::uint32_t mask = 0;
    Lanes<N> near;
    B boxes;

    /// Removes boxes that `keep(const EnteredBox&)` refuses; nothing inside them is visited.
    template <class Keep>
    RAYNEST_INLINE void keep_if(Keep&& keep) {
        if (mask == 0) return;
        alignas(32) float nears[lane_count];
        near.store(nears);
        for_each_lane<N>(mask, [&](int lane) RAYNEST_INLINE_LAMBDA {
            if (!keep(EnteredBox{boxes.box_of(lane), nears[lane]})) mask &= ~(1U << lane);
        });
    }
};

}  // namespace raynest
