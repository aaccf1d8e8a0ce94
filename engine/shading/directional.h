// KHR_lights_punctual's directional light: lux on a surface that faces it.
#pragma once

#include "engine/shading/light.h"

namespace raynest {

struct DirectionalLight {
    static constexpr bool distant = true;
    static float power(const LightRecord& light) { return brightness(light.intensity); }
    static LightSample sample(const LightRecord& light, const Vec3& /*from*/, const Vec2& /*u*/) {
        LightSample sample;
        sample.direction = -light.direction;
        sample.radiance = light.intensity;
        sample.density = 1;
        return sample;
    }
};

}  // namespace raynest
