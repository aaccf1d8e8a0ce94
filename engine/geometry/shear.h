// The ray's frame of the watertight triangle test: a shear that makes the ray the z axis.
#pragma once

#include "engine/geometry/slabs.h"
#include "engine/math/vec.h"

#include <algorithm>
#include <cmath>
#include <cstdint>

namespace raynest {

/// x, y, z name axes of the level's space: z is the direction's largest component. Seen from the
/// origin, a point p lies at (p[x] + to_x p[z], p[y] + to_y p[z]) and t = scale p[z]. Triangles
/// keep their winding where scale > 0 and lose it where scale < 0.
template <class Value>
struct ShearTerms {
    std::uint32_t x, y, z;
    Value origin_x, origin_y, origin_z;  ///< the ray's origin along these axes
    Value to_x, to_y;
    Value scale;

    /// Names the other axes so that turning from one to the next keeps triangles' winding.
    RAYNEST_INLINE void look_along(std::uint32_t axis) {
        z = axis;
        x = (1U << z) & 3U;  // 1, 2, 0
        y = x ^ z ^ 3U;
    }
};

/// The shear of one ray.
struct Shear : ShearTerms<float> {
    /// Makes a shear with which every triangle test fails.
    RAYNEST_FN Shear() : ShearTerms<float>{} {}
    RAYNEST_INLINE explicit Shear(const RayView& ray) {
        const Vec3& d = ray.direction;
        const Vec3 size{std::abs(d.x), std::abs(d.y), std::abs(d.z)};
        // Without branches: they would be mispredicted on every other incoherent ray.
        const auto y_beats_x = static_cast<std::uint32_t>(size.y > size.x);
        const auto z_beats_both = static_cast<std::uint32_t>(size.z > std::max(size.x, size.y));
        look_along(y_beats_x >> z_beats_both | z_beats_both << 1);
        // In registers: through memory the loads would wait until what was stored piece by piece has
        // left the CPU.
        using F = Lanes<4>;
        const Vec3 from = F::of(ray.origin).turned_to(z).to_vec3();
        origin_x = from.x;
        origin_y = from.y;
        origin_z = from.z;
        // The reciprocals of the box rule; the largest component is never limited.
        scale = limited_reciprocal(d).turned_to(z).to_vec3().z;
        const Vec3 to = ((F::splat(0) - F::of(d).turned_to(z)) * F::splat(scale)).to_vec3();
        to_x = to.x;
        to_y = to.y;
    }
};

/// Kept by a ray that enters a tree, else computed.
template <class R>
[[nodiscard]] RAYNEST_INLINE decltype(auto) shear_of(const R& ray) {
    if constexpr (requires { ray.shear; }) {
        return (ray.shear);
    } else {
        return Shear(ray);
    }
}

}  // namespace raynest
