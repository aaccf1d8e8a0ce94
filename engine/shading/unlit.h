// KHR_materials_unlit: shows its base colour, whatever the light, scatters nothing and lights
// nothing.
#pragma once

#include "engine/shading/material.h"

namespace raynest {

struct Unlit {
    static constexpr bool lights_others = false;

    Unlit(const MaterialPoint& point, const Vec3& /*outgoing*/) : colour(point.base_colour) {}
    [[nodiscard]] Vec3 emitted() const { return colour; }
    [[nodiscard]] bool scatters() const { return false; }
    [[nodiscard]] Vec3 evaluate(const Vec3& /*incoming*/) const { return Vec3(0); }
    [[nodiscard]] float density(const Vec3& /*incoming*/) const { return 0; }
    [[nodiscard]] Vec3 sample(float /*choice*/, const Vec2& /*u*/) const { return Vec3(0); }

    Vec3 colour;
};

}  // namespace raynest
