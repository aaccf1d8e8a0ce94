// The glossy lobe of metal and varnish: GGX with Schlick's Fresnel term, and the light of its
// further bounces as a lobe of its own, which is reciprocal and keeps the energy (Kulla and Conty,
// "Revisiting Physically Based Shading at Imageworks", 2017).
#pragma once

#include "engine/shading/albedo_tables.h"
#include "engine/shading/ggx.h"
#include "engine/shading/material.h"

namespace raynest {

/// How much of a lobe's light comes back after more than one bounce, relative to what the first one
/// leaves; f0 is the reflectance along the normal, f90 at grazing angles.
inline Vec3 further_bounces(const Vec3& f0, float full_mean, float f90 = 1) {
    const Vec3 mean = f0 + (Vec3(f90) - f0) * (1.0F / 21.0F);
    return mean * mean * full_mean / (Vec3(1) - mean * (1.0F - full_mean));
}

/// The first bounce. `f0` may be a sum of lobes: the Fresnel term is linear in it.
struct GlossyLobe {
    Vec3 outgoing;
    float alpha;
    Vec3 f0;
    float f90 = 1;  ///< the weight of the lobes: reflectance at grazing angles
    float outer = 1.0F + ggx_lambda(outgoing, alpha);
    float sharpness = 1.0F / (alpha * alpha);

    [[nodiscard]] static GlossyLobe of(const MaterialPoint& /*point*/, const Vec3& outgoing,
                                       float roughness, const Vec3& f0, float f90) {
        return {outgoing, ggx_alpha(roughness), f0, f90};
    }
    [[nodiscard]] static float round_roughness(const MaterialPoint& /*point*/, float roughness) {
        return roughness;
    }

    /// As ggx_density() and ggx_masking() say, with the divisions of all directions done once.
    [[nodiscard]] Scattered scatter(const Vec3& i) const {
        if (i.z <= 0 || outgoing.z <= 0) return {};
        const Vec3 h = glm::normalize(outgoing + i);
        const float seen = glm::dot(outgoing, h);
        const float sum = (h.x * h.x + h.y * h.y) * sharpness + h.z * h.z;
        const float facets = sharpness / (4.0F * pi * outgoing.z * sum * sum);
        const Vec3 fresnel = f0 + (Vec3(f90) - f0) * schlick_weight(seen);
        return {fresnel * (facets / (outer + ggx_lambda(i, alpha))),
                seen > 0 ? facets / outer : 0.0F};
    }
    [[nodiscard]] Vec3 sample(const Vec2& u) const {
        const Vec3 h = sample_ggx(outgoing, alpha, u);
        const Vec3 i = 2.0F * glm::dot(outgoing, h) * h - outgoing;
        return i.z > 0 ? i : Vec3(0);
    }
};

}  // namespace raynest
