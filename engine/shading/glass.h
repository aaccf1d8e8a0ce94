// The lobe of transparent surfaces: rough refraction into a solid (Walter et al., "Microfacet
// Models for Refraction", 2007), or a sheet that lets light go straight on, as rough as it is.
//
// Radiance is not scaled by the square of the index: paths that enter a solid leave it again, and
// the two factors are each other's inverse. Light of further bounces is given back by scaling.
#pragma once

#include "engine/shading/albedo_tables.h"
#include "engine/shading/ggx.h"

namespace raynest {

struct GlassLobe {
    Vec3 outgoing;
    float roughness;
    float eta;  ///< index beyond the surface over index on this side
    bool solid;
    Vec3 colour;  ///< what transmitted light is multiplied by
    float alpha = ggx_alpha(roughness);
    float gain = 1.0F / (solid ? glass_albedo(outgoing.z, roughness, eta)
                               : std::max(albedo_tables().full.at(outgoing.z, roughness), 0.05F));

    [[nodiscard]] Vec3 evaluate(const Vec3& i) const {
        const Half half = half_of(i);
        if (!half.valid) return Vec3(0);
        const float reflected = fresnel_dielectric(half.seen, eta);
        const float common = ggx_density(half.h, alpha) * ggx_masking(outgoing, i, alpha) *
                             half.seen * gain / outgoing.z * half.jacobian;
        return i.z > 0 ? Vec3(reflected * common) : colour * ((1.0F - reflected) * common);
    }
    [[nodiscard]] float density(const Vec3& i) const {
        const Half half = half_of(i);
        if (!half.valid) return 0;
        const float reflected = fresnel_dielectric(half.seen, eta);
        return ggx_visible_density(outgoing, half.h, alpha) * half.jacobian *
               (i.z > 0 ? reflected : 1.0F - reflected);
    }
    [[nodiscard]] Vec3 sample(float choice, const Vec2& u) const {
        const Vec3 h = sample_ggx(outgoing, alpha, u);
        const float seen = glm::dot(outgoing, h);
        const Vec3 mirror = 2.0F * seen * h - outgoing;
        if (choice < fresnel_dielectric(seen, eta)) return mirror.z > 0 ? mirror : Vec3(0);
        if (!solid) return mirror.z > 0 ? Vec3(mirror.x, mirror.y, -mirror.z) : Vec3(0);
        const float sine2 = (1.0F - seen * seen) / (eta * eta);
        if (sine2 >= 1) return Vec3(0);
        const Vec3 i = (seen / eta - std::sqrt(1.0F - sine2)) * h - outgoing / eta;
        return i.z < 0 ? glm::normalize(i) : Vec3(0);
    }

private:
    /// The microfacet that sends light from `i` to `outgoing`, and the solid angle of microfacet
    /// normals per solid angle of `i`.
    struct Half {
        Vec3 h{0};
        float seen = 0;
        float jacobian = 0;
        bool valid = false;
    };
    [[nodiscard]] Half half_of(const Vec3& i) const {
        Half half;
        if (outgoing.z <= 0 || i.z == 0) return half;
        if (i.z > 0 || !solid) {
            const Vec3 mirror(i.x, i.y, std::abs(i.z));
            half.h = glm::normalize(outgoing + mirror);
            half.seen = glm::dot(outgoing, half.h);
            half.jacobian = half.seen > 0 ? 1.0F / (4.0F * half.seen) : 0.0F;
            half.valid = half.seen > 0;
            return half;
        }
        Vec3 h = outgoing + eta * i;
        const float length = glm::length(h);
        if (length < 1e-7F) return half;
        h /= length;
        if (h.z < 0) h = -h;
        half.h = h;
        half.seen = glm::dot(outgoing, h);
        const float beyond = glm::dot(i, h);
        if (half.seen <= 0 || beyond >= 0) return half;
        const float sum = half.seen + eta * beyond;
        half.jacobian = eta * eta * -beyond / (sum * sum);
        half.valid = std::isfinite(half.jacobian);
        return half;
    }
};

}  // namespace raynest
