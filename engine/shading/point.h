// KHR_lights_punctual's point light: candela in all directions.
#pragma once

#include "engine/shading/light.h"

namespace raynest {

struct PointLight {
    static constexpr bool distant = false;
    static float power(const LightRecord& light) { return 4.0F * pi * brightness(light.intensity); }
    static LightSample sample(const LightRecord& light, const Vec3& from, const Vec2& /*u*/) {
        const Vec3 way = light.position - from;
        const float distance = glm::length(way);
        LightSample sample;
        if (!(distance > 0)) return sample;
        sample.direction = way / distance;
        sample.distance = distance;
        sample.end = glm::dvec3(light.position);
        sample.ends = true;
        sample.density = 1;
        sample.radiance = light.intensity * (window(distance, light.range) / (distance * distance));
        return sample;
    }
    /// The extension's fade towards `range`; 1 without a range.
    static float window(float distance, float range) {
        if (!(range > 0)) return 1;
        const float part = distance / range;
        const float part2 = part * part;
        return std::clamp(1.0F - part2 * part2, 0.0F, 1.0F);
    }
};

}  // namespace raynest
