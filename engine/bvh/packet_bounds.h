// Boxes against a whole set of rays: the interval of what each ray's own test would answer.
#pragma once

#include "engine/bvh/node.h"
#include "engine/bvh/packet.h"
#include "engine/geometry/triangle.h"

#include <algorithm>
#include <cmath>
#include <cstdint>

namespace raynest {

/// A box test for all rays of one octant together, widened so that it passes wherever the test of a
/// single ray would.
///
/// Per axis, near = min over rays of (plane - origin) / direction. The box rule of one ray may be
/// lower than the exact value by twice its error term and a few roundings; three times the largest
/// term and 2^-20 of the slope contain all of it.
class PacketBounds {
    using F8 = Lanes<8>;

public:
    PacketBounds(const PacketLevel& level, const PacketRange& range, float origin_error,
                 RayMask rays, std::uint32_t octant) {
        constexpr float slack = 0x1p-20F;
        float extent = 0;
        float lower[3], upper[3];
        for (std::uint32_t axis = 0; axis < 3; ++axis) {
            lower[axis] = least_of(level.origin[axis], rays);
            upper[axis] = most_of(level.origin[axis], rays);
            one_origin_ = one_origin_ && lower[axis] == upper[axis];
            least_slope_[axis] = least_of(level.reciprocal[axis], rays);
            most_slope_[axis] = most_of(level.reciprocal[axis], rays);
            extent = std::max({extent, std::abs(lower[axis]), std::abs(upper[axis])});
        }
        tmin_ = least_of(range.tmin, rays);
        extent *= 3 * origin_error * box_origin_error;
        for (int axis = 0; axis < 3; ++axis) {
            near_row_[axis] = octant >> axis & 1U;
            const bool backwards = near_row_[axis] != 0;
            near_origin_[axis] = backwards ? lower[axis] - extent : upper[axis] + extent;
            far_origin_[axis] = backwards ? upper[axis] + extent : lower[axis] - extent;
            least_slope_[axis] *= backwards ? 1 + slack : 1 - slack;
            most_slope_[axis] *= backwards ? 1 - slack : 1 + slack;
        }
    }

    /// All rays start at the same point.
    [[nodiscard]] bool has_one_origin() const { return one_origin_; }
    /// Which row of planes, lower (0) or upper (1), the rays meet first along an axis.
    [[nodiscard]] RAYNEST_INLINE std::uint32_t near_row(int axis) const { return near_row_[axis]; }

    /// Children of a node that a ray of the set may enter before `tmax`; where the first does.
    RAYNEST_INLINE std::uint32_t enter_boxes(const Node& node, float tmax, F8& near_out) const {
        const float(*rows)[3][8] = &node.lower;
        const auto plane = [&](std::uint32_t row, int axis)
                               RAYNEST_INLINE_LAMBDA { return F8::load(rows[row][axis]); };
        return enter(plane, tmax, near_out) & node.valid();
    }

    /// Triangles of a block whose own boxes a ray of the set may enter: those of a leaf lie side by
    /// side, and a packet is often smaller than they are (measured: 1.25 times on alpha cards).
    RAYNEST_INLINE std::uint32_t enter_triangles(const TriangleBlock& block, float tmax) const {
        const auto plane = [&](std::uint32_t row, int axis) RAYNEST_INLINE_LAMBDA {
            const F8 a = F8::load(block.vertex[0][axis]);
            const F8 b = F8::load(block.vertex[1][axis]);
            const F8 c = F8::load(block.vertex[2][axis]);
            return row == 0 ? minimum(a, minimum(b, c)) : maximum(a, maximum(b, c));
        };
        F8 near;
        return enter(plane, tmax, near) & Triangles8{&block, false}.valid();
    }

private:
    /// `plane(row, axis)` are the lower (row 0) or upper sides of eight boxes.
    template <class Plane>
    RAYNEST_INLINE std::uint32_t enter(const Plane& plane, float tmax, F8& near_out) const {
        const auto least = [&](int axis) RAYNEST_INLINE_LAMBDA {
            const F8 a = plane(near_row_[axis], axis) - F8::splat(near_origin_[axis]);
            return minimum(a * F8::splat(least_slope_[axis]), a * F8::splat(most_slope_[axis]));
        };
        const auto most = [&](int axis) RAYNEST_INLINE_LAMBDA {
            const F8 a = plane(near_row_[axis] ^ 1U, axis) - F8::splat(far_origin_[axis]);
            return maximum(a * F8::splat(least_slope_[axis]), a * F8::splat(most_slope_[axis]));
        };
        near_out = maximum(maximum(least(0), least(1)), maximum(least(2), F8::splat(tmin_)));
        const F8 far = minimum(minimum(most(0), most(1)), minimum(most(2), F8::splat(tmax)));
        return less_equal(near_out, far);
    }

    float near_origin_[3], far_origin_[3];
    float least_slope_[3], most_slope_[3];
    std::uint32_t near_row_[3];
    float tmin_;
    bool one_origin_ = true;
};

}  // namespace raynest
