// Rays of a packet that start at one point, and the triangles that none of them meets.
//
// Seen from there, the side on which a ray passes an edge is linear in the ray's slopes: with the
// edge's ends p and q sheared along the packet's middle ray, and s and t the slopes against it,
//
//   edge(s, t) = (x_p y_q - y_p x_q) + s (z_p y_q - y_p z_q) + t (x_p z_q - z_p x_q)
//
// so its least and its largest value over a rectangle of slopes are known at once, for eight
// triangles in a vector. Where one edge has all rays on one side and another has them on the other,
// no ray meets the triangle: a hit has its three edges on the same side
// (geometry/intersect_triangle.h). A box cannot tell that, long triangles' boxes contain everything
// (measured, camera rays of an interior: a fifteenth of the tests of sixteen rays against a
// triangle that boxes let through, 1.45 times as fast; of cards a third, 1.02 times).
//
// Rounding: over the whole rectangle, with |z| <= deep and |x|, |y| <= wide for every corner, what
// a ray computes for an edge is wrong by less than 2^-24 (4 deep wide + 7 wide^2), and what is
// computed here by less than 2^-24 (8 deep wide + 33 wide^2). Nothing counts as on one side that
// is not there by more than both; NaN and overflow are on no side.
#pragma once

#include "engine/bvh/packet.h"
#include "engine/geometry/triangle.h"
#include "engine/math/mask.h"

#include <algorithm>
#include <cstdint>

namespace raynest {

class Frustum {
    using F8 = Lanes<8>;

public:
    /// Bounds a non-empty set of rays that share their origin and have their largest direction
    /// component along `axis`.
    RAYNEST_INLINE Frustum(const PacketLevel& level, RayMask rays, std::uint32_t axis)
        : axis(axis) {
        axes_.look_along(axis);
        const auto first = lowest_bit(rays);
        axes_.origin_x = level.shear_origin[0].of[first];
        axes_.origin_y = level.shear_origin[1].of[first];
        axes_.origin_z = level.shear_origin[2].of[first];
        Range group_x[packet_groups], group_y[packet_groups];
        Range x, y;
        for (std::uint32_t g = 0; g < packet_groups; ++g) {
            const std::uint32_t members = group_mask(rays, g);
            x.extend(group_x[g] = Range(level.shear_to[0].group(g), members));
            y.extend(group_y[g] = Range(level.shear_to[1].group(g), members));
        }
        axes_.to_x = x.middle();
        axes_.to_y = y.middle();
        reach_ = std::max(x.half(), y.half());
        for (std::uint32_t g = 0; g < packet_groups; ++g) {
            groups_[g] = {group_x[g].middle() - axes_.to_x, group_x[g].half(),
                          group_y[g].middle() - axes_.to_y, group_y[g].half()};
        }
    }

    /// The edges of a block's triangles, as linear functions of the slopes.
    struct Edges {
        F8 at_middle[3], by_x[3], by_y[3];
        F8 error;
    };
    [[nodiscard]] RAYNEST_INLINE Edges edges_of(const TriangleBlock& block) const {
        auto [x, y, z] = seen(block);
        F8 deep = F8::splat(0);
        F8 wide = F8::splat(0);
        for (int k = 0; k < 3; ++k) {
            x[k] = fused(F8::splat(axes_.to_x), z[k], x[k]);
            y[k] = fused(F8::splat(axes_.to_y), z[k], y[k]);
            deep = maximum(deep, absolute(z[k]));
            wide = maximum(wide, maximum(absolute(x[k]), absolute(y[k])));
        }
        wide = fused(F8::splat(reach_), deep, wide);

        Edges edges;
        edges.error = F8::splat(0x1p-19F) * wide * fused(F8::splat(2), wide, deep);
        for (int q = 0; q < 3; ++q) {
            const int p = (q + 1) % 3;
            edges.at_middle[q] = x[p] * y[q] - y[p] * x[q];
            edges.by_x[q] = z[p] * y[q] - y[p] * z[q];
            edges.by_y[q] = x[p] * z[q] - z[p] * x[q];
        }
        return edges;
    }

    /// Triangles that rays of group `g` may meet, a bit each.
    [[nodiscard]] RAYNEST_INLINE std::uint32_t may_meet(const Edges& edges, std::uint32_t g) const {
        const Slopes& slopes = groups_[g];
        std::uint32_t above = 0;
        std::uint32_t below = 0;
        for (int q = 0; q < 3; ++q) {
            const F8 middle =
                fused(F8::splat(slopes.middle_x), edges.by_x[q],
                      fused(F8::splat(slopes.middle_y), edges.by_y[q], edges.at_middle[q]));
            const F8 reach =
                fused(F8::splat(slopes.half_x), absolute(edges.by_x[q]),
                      fused(F8::splat(slopes.half_y), absolute(edges.by_y[q]), edges.error));
            above |= less(reach, middle);
            below |= less(reach, F8::splat(0) - middle);
        }
        return 0xFFU & ~(above & below);
    }

    /// Those of `rays` that have the three edges of a triangle of the block on one side: the others
    /// do not meet any. No branch depends on an answer; in the full test one does, which is
    /// mispredicted for every other ray (measured: 1.04 times for all of a search).
    [[nodiscard]] RAYNEST_INLINE RayMask between_edges(const PacketLevel& level,
                                                       const Triangles8& block,
                                                       RayMask rays) const {
        const Corners corners = seen(*block.block);
        const std::uint32_t valid = block.valid();
        RayMask between = 0;
        for (RayMask rest = rays; rest != 0; rest &= rest - 1) {
            const auto i = lowest_bit(rest);
            const F8 to_x = F8::splat(level.shear_to[0].of[i]);
            const F8 to_y = F8::splat(level.shear_to[1].of[i]);
            F8 x[3], y[3];
            for (int k = 0; k < 3; ++k) {
                x[k] = fused(to_x, corners.z[k], corners.x[k]);
                y[k] = fused(to_y, corners.z[k], corners.y[k]);
            }
            const auto edge = [&](int p, int q)
                                  RAYNEST_INLINE_LAMBDA { return x[p] * y[q] - y[p] * x[q]; };
            const F8 a = edge(2, 1), b = edge(0, 2), c = edge(1, 0);
            const F8 zero = F8::splat(0);
            const std::uint32_t mask = less_equal(zero, minimum(a, minimum(b, c))) |
                                       less_equal(maximum(a, maximum(b, c)), zero);
            between |= RayMask{(mask & valid) != 0} << i;
        }
        return between;
    }

    const std::uint32_t axis;  ///< along which all directions are largest

private:
    /// The range of some rays' slopes.
    struct Range {
        float least = std::numeric_limits<float>::infinity();
        float most = -std::numeric_limits<float>::infinity();

        Range() = default;
        RAYNEST_INLINE Range(const PacketLanes& slopes, std::uint32_t members)
            : least(raynest::least(select(members, slopes, PacketLanes::splat(least)))),
              most(raynest::most(select(members, slopes, PacketLanes::splat(most)))) {}
        RAYNEST_INLINE void extend(const Range& other) {
            least = std::min(least, other.least);
            most = std::max(most, other.most);
        }
        [[nodiscard]] RAYNEST_INLINE float middle() const { return 0.5F * (least + most); }
        /// Half the width, and what middle() and differences of middles are rounded by: slopes are
        /// at most 1.
        [[nodiscard]] RAYNEST_INLINE float half() const { return 0.5F * (most - least) + 0x1p-23F; }
    };
    /// Slopes of a group, relative to the middle of the packet.
    struct Slopes {
        float middle_x, half_x;
        float middle_y, half_y;
    };
    /// Corners of a block's triangles, seen from the origin along the rays' axes.
    struct Corners {
        F8 x[3], y[3], z[3];
    };
    [[nodiscard]] RAYNEST_INLINE Corners seen(const TriangleBlock& block) const {
        Corners corners;
        for (int k = 0; k < 3; ++k) {
            const auto from = [&](std::uint32_t along, float origin) RAYNEST_INLINE_LAMBDA {
                return F8::load(block.vertex[k][along]) - F8::splat(origin);
            };
            corners.x[k] = from(axes_.x, axes_.origin_x);
            corners.y[k] = from(axes_.y, axes_.origin_y);
            corners.z[k] = from(axes_.z, axes_.origin_z);
        }
        return corners;
    }
    RAYNEST_INLINE static F8 absolute(const F8& a) { return flip_sign(a, a); }

    ShearTerms<float> axes_;  ///< the middle ray's; its scale is not used
    float reach_;             ///< the largest distance of a slope from the middle's
    Slopes groups_[packet_groups];
};

}  // namespace raynest
