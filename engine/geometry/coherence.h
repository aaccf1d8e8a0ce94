// When rays are coherent enough to walk a tree together.
#pragma once

#include "engine/geometry/box.h"
#include "engine/geometry/ray.h"

#include <span>

namespace raynest {

/// How far rays may look apart (tangent of the angle, about 7 degrees), and start apart (share of
/// the object's size). Wider packets test more boxes than their rays would one by one.
inline constexpr float coherent_turn = 0.125F;
inline constexpr float coherent_shift = 0.0625F;

/// Whether two rays look the same way from the same place, seen from a scene of these bounds.
[[nodiscard]] inline bool are_alike(const Ray& a, const Ray& b, const Box& bounds) {
    return largest_component(a.direction - b.direction) <=
               coherent_turn * largest_component(a.direction) &&
           largest_component(a.origin - b.origin) <=
               coherent_shift * largest_component(bounds.size());
}

/// Whether all rays look the same way from the same place, seen from a scene of these bounds. False
/// for none.
[[nodiscard]] inline bool is_coherent(std::span<const Ray> rays, const Box& bounds) {
    if (rays.empty()) return false;
    Box origins;
    Box directions;
    for (const Ray& ray : rays) {
        origins.extend(ray.origin);
        directions.extend(ray.direction);
    }
    return largest_component(directions.size()) <=
               coherent_turn * largest_component(rays.front().direction) &&
           largest_component(origins.size()) <= coherent_shift * largest_component(bounds.size());
}

}  // namespace raynest
