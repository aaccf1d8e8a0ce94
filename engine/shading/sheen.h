// The lobe of cloth: fibres that stand up from the surface and shine at grazing angles (Estevez and
// Kulla, "Production Friendly Microfacet Sheen BRDF", 2017; as KHR_materials_sheen asks).
#pragma once

#include "engine/shading/sampling.h"

#include <algorithm>

namespace raynest {

class SheenLobe {
public:
    SheenLobe(float outgoing_cosine, float roughness)
        : outgoing_cosine_(outgoing_cosine),
          // Below, the fibres' density outgrows a float.
          alpha_(std::max(roughness * roughness, 0.005F)),
          outer_(lambda(outgoing_cosine)) {}

    /// The white lobe's BSDF x cosine; `o` and `i` lie above the surface.
    [[nodiscard]] float evaluate(const Vec3& o, const Vec3& i) const {
        const Vec3 h = glm::normalize(o + i);
        const float sine2 = std::max(h.x * h.x + h.y * h.y, 1e-12F);
        const float power = 0.5F / alpha_;
        const float fibres =
            (2.0F + 1.0F / alpha_) * rough_exp2(power * rough_log2(sine2)) / (2 * pi);
        const float seen = 4.0F * outgoing_cosine_ * i.z * (1.0F + outer_ + lambda(i.z));
        return fibres * std::min(1.0F / seen, 1.0F) * i.z;
    }

private:
    /// A fit to how fibres hide each other.
    [[nodiscard]] float lambda(float cosine) const {
        constexpr float log2_e = 1.44269504F;
        const float x = cosine < 0.5F ? fit(cosine) : 2.0F * fit(0.5F) - fit(1.0F - cosine);
        return rough_exp2(log2_e * x);
    }
    [[nodiscard]] float fit(float x) const {
        const float t = (1.0F - alpha_) * (1.0F - alpha_);
        const auto mixed = [t](float rough, float smooth) { return rough + t * (smooth - rough); };
        const float power = rough_exp2(mixed(0.19823F, 0.16801F) * rough_log2(std::max(x, 1e-7F)));
        return mixed(21.5473F, 25.3245F) / (1.0F + mixed(3.82987F, 3.32435F) * power) +
               mixed(-1.97760F, -1.27393F) * x + mixed(-4.32054F, -4.85967F);
    }

    float outgoing_cosine_, alpha_, outer_;
};

}  // namespace raynest
