// KHR_lights_punctual's spot light: a point light that fades between two cones.
#pragma once

#include "engine/shading/point.h"

#include <algorithm>
#include <array>
#include <numbers>
#include <utility>

namespace raynest {

struct SpotLight {
    static constexpr bool distant = false;
    /// Full light within the inner cone, none outside the outer one.
    static constexpr std::array numbers{
        LightNumber{"inner_cosine", 1, -1, 1},
        LightNumber{"outer_cosine", std::numbers::sqrt2_v<float> / 2, -1, 1}};
    static float power(const LightRecord& light) {
        return 2.0F * pi * (1.0F - 0.5F * (light.own[0] + light.own[1])) *
               brightness(light.intensity);
    }
    static LightSample sample(const LightRecord& light, const Vec3& from, const Vec2& u) {
        LightSample sample = PointLight::sample(light, from, u);
        const float cosine = -glm::dot(sample.direction, light.direction);
        const auto [inner, outer] = std::pair{light.own[0], light.own[1]};
        const float width = std::max(inner - outer, 1e-3F);
        const float part = std::clamp((cosine - outer) / width, 0.0F, 1.0F);
        sample.radiance *= part * part;
        return sample;
    }
};

}  // namespace raynest
