// KHR_lights_punctual's spot light: a point light that fades between two cones.
#pragma once

#include "engine/shading/point.h"

namespace raynest {

struct SpotLight {
    static constexpr bool distant = false;
    static float power(const LightRecord& light) {
        return 2.0F * pi * (1.0F - 0.5F * (light.inner_cosine + light.outer_cosine)) *
               brightness(light.intensity);
    }
    static LightSample sample(const LightRecord& light, const Vec3& from, const Vec2& u) {
        LightSample sample = PointLight::sample(light, from, u);
        const float cosine = -glm::dot(sample.direction, light.direction);
        const float width = std::max(light.inner_cosine - light.outer_cosine, 1e-3F);
        const float part = std::clamp((cosine - light.outer_cosine) / width, 0.0F, 1.0F);
        sample.radiance *= part * part;
        return sample;
    }
};

}  // namespace raynest
