#include "engine/queries/coherence.h"

#include <algorithm>
#include <cmath>

namespace raynest {

bool is_coherent(std::span<const Ray> rays, const Box& bounds) {
    if (rays.empty()) return false;
    Box origins;
    Box directions;
    for (const Ray& ray : rays) {
        origins.extend(ray.origin);
        directions.extend(ray.direction);
    }
    const auto largest = [](const Vec3& v) {
        return std::max({std::abs(v.x), std::abs(v.y), std::abs(v.z)});
    };
    return largest(directions.size()) <= coherent_turn * largest(rays.front().direction) &&
           largest(origins.size()) <= coherent_shift * largest(bounds.size());
}

}  // namespace raynest
