// Sixty-four rays side by side at one level of a scene: what the packet traversal tests at once.
//
// The same terms as of a single ray (geometry/slabs.h, geometry/shear.h), computed by the same
// operations in the same order, so that a lane of a packet has the bits that the ray would have by
// itself.
#pragma once

#include "engine/bvh/visit.h"

#include <cstdint>

namespace raynest {

inline constexpr std::uint32_t packet_rays = 64;
inline constexpr int packet_lanes = 16;  ///< rays per step of a loop over the packet
inline constexpr std::uint32_t packet_groups = packet_rays / packet_lanes;
inline constexpr std::uint32_t group_bits = (1U << packet_lanes) - 1;
using PacketLanes = Lanes<packet_lanes>;

/// One bit per ray of a packet.
using RayMask = std::uint64_t;

/// Those of a set that are in group g, one bit per lane.
[[nodiscard]] RAYNEST_INLINE std::uint32_t group_mask(RayMask rays, std::uint32_t g) {
    return static_cast<std::uint32_t>(rays >> (packet_lanes * g) & group_bits);
}

struct alignas(64) PacketRow {
    float of[packet_rays];

    [[nodiscard]] RAYNEST_INLINE PacketLanes group(std::uint32_t g) const {
        return PacketLanes::load(of + packet_lanes * g);
    }
    RAYNEST_INLINE void set_group(std::uint32_t g, const PacketLanes& values) {
        values.store(of + packet_lanes * g);
    }
};

/// The least (most) value of the rays of a set that is not empty.
[[nodiscard]] RAYNEST_INLINE float least_of(const PacketRow& row, RayMask rays) {
    auto r = PacketLanes::splat(std::numeric_limits<float>::infinity());
    for (std::uint32_t g = 0; g < packet_groups; ++g) {
        r = minimum(r, select(group_mask(rays, g), row.group(g), r));
    }
    return least(r);
}
[[nodiscard]] RAYNEST_INLINE float most_of(const PacketRow& row, RayMask rays) {
    auto r = PacketLanes::splat(-std::numeric_limits<float>::infinity());
    for (std::uint32_t g = 0; g < packet_groups; ++g) {
        r = maximum(r, select(group_mask(rays, g), row.group(g), r));
    }
    return most(r);
}

/// The range of each ray, common to all levels because t has the same meaning everywhere.
struct PacketRange {
    PacketRow tmin;
    PacketRow tmax;
};

/// The rays as one object sees them.
struct PacketLevel {
    PacketRow origin[3], direction[3];
    PacketRow reciprocal[3];
    PacketRow near_scale[3], near_offset[3], far_scale[3], far_offset[3];
    PacketRow shear_origin[3], shear_to[2], shear_scale;  ///< along each ray's own axes
    RayMask backwards[3];  ///< rays that meet the upper plane of the axis first
    RayMask largest[3];    ///< rays whose largest component is along the axis
    RayMask finite;        ///< rays whose box terms do not overflow

    /// Computes all but origin and direction.
    RAYNEST_INLINE void prepare(float origin_error) {
        for (RayMask& set : backwards) set = 0;
        for (RayMask& set : largest) set = 0;
        finite = 0;
        for (std::uint32_t g = 0; g < packet_groups; ++g) prepare_group(g, origin_error);
    }

private:
    RAYNEST_INLINE void prepare_group(std::uint32_t g, float origin_error) {
        using F = PacketLanes;
        const std::uint32_t shift = packet_lanes * g;
        const auto absolute = [](const F& a) { return flip_sign(a, a); };
        const auto largest_of = [&](const PacketRow(&v)[3]) {
            return maximum(maximum(absolute(v[0].group(g)), absolute(v[1].group(g))),
                           absolute(v[2].group(g)));
        };
        const F extent = largest_of(origin) * F::splat(origin_error * box_origin_error);
        const F smallest = largest_of(direction) * F::splat(direction_min_relative);
        std::uint32_t bounded = group_bits;
        for (std::uint32_t axis = 0; axis < 3; ++axis) {
            const F d = direction[axis].group(g);
            const F r = F::splat(1) / flip_sign(maximum(absolute(d), smallest), d);
            const F m = F::splat(0) - origin[axis].group(g) * r;
            const F e = absolute(r) * extent;
            reciprocal[axis].set_group(g, r);
            near_scale[axis].set_group(g, r * F::splat(box_near_factor));
            near_offset[axis].set_group(g, (m - e) * F::splat(box_near_factor));
            far_scale[axis].set_group(g, r * F::splat(box_far_factor));
            far_offset[axis].set_group(g, (m + e) * F::splat(box_far_factor));
            backwards[axis] |= RayMask{less(r, F::splat(0))} << shift;
            bounded &= less((absolute(m) + e) * F::splat(box_far_factor),
                            F::splat(std::numeric_limits<float>::max()));
        }
        finite |= RayMask{bounded} << shift;

        const F x = absolute(direction[0].group(g));
        const F y = absolute(direction[1].group(g));
        const std::uint32_t z_largest = less(maximum(x, y), absolute(direction[2].group(g)));
        const std::uint32_t y_largest = less(x, y) & ~z_largest;
        largest[2] |= RayMask{z_largest} << shift;
        largest[1] |= RayMask{y_largest} << shift;
        const std::uint32_t x_largest = group_bits & ~(z_largest | y_largest);
        largest[0] |= RayMask{x_largest} << shift;

        // As ShearTerms::look_along turns the axes: z is x, y, z; x is y, z, x; y is z, x, y.
        const auto turned = [&](const PacketRow(&v)[3], std::uint32_t by) {
            return select(x_largest, v[by].group(g),
                          select(y_largest, v[(by + 1) % 3].group(g), v[(by + 2) % 3].group(g)));
        };
        const F scale = turned(reciprocal, 0);
        shear_scale.set_group(g, scale);
        for (std::uint32_t axis = 0; axis < 3; ++axis) {
            shear_origin[axis].set_group(g, turned(origin, (axis + 1) % 3));
        }
        for (std::uint32_t axis = 0; axis < 2; ++axis) {
            shear_to[axis].set_group(g, (F::splat(0) - turned(direction, axis + 1)) * scale);
        }
    }
};

/// is_valid() of every ray, of the rows of what requests gave.
[[nodiscard]] RAYNEST_INLINE RayMask valid_rays(const PacketLevel& level,
                                                const PacketRange& range) {
    using F = PacketLanes;
    RayMask valid = 0;
    for (std::uint32_t g = 0; g < packet_groups; ++g) {
        const auto is_finite = [&](const PacketRow& row) RAYNEST_INLINE_LAMBDA {
            const F a = row.group(g);
            return less_equal(flip_sign(a, a), F::splat(std::numeric_limits<float>::max()));
        };
        const F zero = F::splat(0);
        const F tmin = range.tmin.group(g);
        std::uint32_t all =
            is_finite(range.tmin) & less_equal(zero, tmin) & less_equal(tmin, range.tmax.group(g));
        std::uint32_t directed = 0;
        for (int axis = 0; axis < 3; ++axis) {
            all &= is_finite(level.origin[axis]) & is_finite(level.direction[axis]);
            const F d = level.direction[axis].group(g);
            directed |= less(zero, flip_sign(d, d));
        }
        valid |= RayMask{all & directed} << (packet_lanes * g);
    }
    return valid;
}

/// Sixteen rays of a packet against one triangle: what geometry/intersect_triangle.h is asked with.
struct RayGroup {
    struct Slabs {
        const PacketLevel& level;
        std::uint32_t g;

        template <int N>
        [[nodiscard]] RAYNEST_INLINE Lanes<N> near_plane(int axis, const Lanes<N>& p) const {
            return fused(p, level.near_scale[axis].group(g), level.near_offset[axis].group(g));
        }
        template <int N>
        [[nodiscard]] RAYNEST_INLINE Lanes<N> far_plane(int axis, const Lanes<N>& p) const {
            return fused(p, level.far_scale[axis].group(g), level.far_offset[axis].group(g));
        }
    };
    Slabs slabs;
    ShearTerms<PacketLanes> shear;
    PacketLanes tmin, tmax;

    /// Rays 16 g to 16 g + 15, whose largest component is along z.
    RAYNEST_INLINE RayGroup(const PacketLevel& level, const PacketRange& range, std::uint32_t g,
                            std::uint32_t z)
        : slabs{level, g},
          tmin(range.tmin.group(g)),
          tmax(range.tmax.group(g)) {
        shear.look_along(z);
        shear.origin_x = level.shear_origin[0].group(g);
        shear.origin_y = level.shear_origin[1].group(g);
        shear.origin_z = level.shear_origin[2].group(g);
        shear.to_x = level.shear_to[0].group(g);
        shear.to_y = level.shear_to[1].group(g);
        shear.scale = level.shear_scale.group(g);
    }
};

/// One ray of a packet, with the terms that the packet has already.
struct PacketRay : RayView {
    struct Slabs {
        const PacketLevel& level;
        std::uint32_t i;

        template <int N>
        [[nodiscard]] RAYNEST_INLINE Lanes<N> near_plane(int axis, const Lanes<N>& p) const {
            return fused(p, Lanes<N>::splat(level.near_scale[axis].of[i]),
                         Lanes<N>::splat(level.near_offset[axis].of[i]));
        }
        template <int N>
        [[nodiscard]] RAYNEST_INLINE Lanes<N> far_plane(int axis, const Lanes<N>& p) const {
            return fused(p, Lanes<N>::splat(level.far_scale[axis].of[i]),
                         Lanes<N>::splat(level.far_offset[axis].of[i]));
        }
    };
    Slabs slabs;
    ShearTerms<float> shear;

    RAYNEST_INLINE PacketRay(const RayView& ray, const PacketLevel& level, std::uint32_t i)
        : RayView(ray),
          slabs{level, i} {
        const auto is_along = [&](int axis) {
            return static_cast<std::uint32_t>(level.largest[axis] >> i & 1U);
        };
        shear.look_along(is_along(1) | is_along(2) << 1);
        shear.origin_x = level.shear_origin[0].of[i];
        shear.origin_y = level.shear_origin[1].of[i];
        shear.origin_z = level.shear_origin[2].of[i];
        shear.to_x = level.shear_to[0].of[i];
        shear.to_y = level.shear_to[1].of[i];
        shear.scale = level.shear_scale.of[i];
    }
};

/// One lane of a block, as sixteen rays see it.
struct SharedTriangle {
    using triangle_tag = void;
    static constexpr int lanes = packet_lanes;
    const TriangleBlock* block;
    std::uint32_t triangle;  ///< the lane of the block

    template <int N>
    [[nodiscard]] RAYNEST_INLINE Lanes<N> coordinate(int k, std::uint32_t axis) const {
        return Lanes<N>::splat(block->vertex[k][axis][triangle]);
    }
    [[nodiscard]] RAYNEST_INLINE std::uint32_t prim_of(int) const {
        return block->triangle[triangle];
    }
    [[nodiscard]] RAYNEST_INLINE std::uint32_t geom_of(int) const { return 0; }
};

}  // namespace raynest
