// The glossy lobe of brushed metal: GGX whose microfacets lean further along one direction of the
// surface than across it (Burley, "Physically Based Shading at Disney", 2012; as
// KHR_materials_anisotropy asks).
#pragma once

#include "engine/shading/ggx.h"
#include "engine/shading/material.h"

namespace raynest {

/// As GlossyLobe. `along` is a unit vector in the plane of the surface.
class AnisotropicLobe {
public:
    [[nodiscard]] static AnisotropicLobe of(const MaterialPoint& point, const Vec3& outgoing,
                                            float roughness, const Vec3& f0, float f90) {
        AnisotropicLobe lobe;
        lobe.along_ = point.along;
        lobe.alpha_ = alpha_of(point, roughness);
        lobe.outgoing = lobe.turned(outgoing);
        lobe.f0 = f0;
        lobe.f90 = f90;
        lobe.outer_ = 1.0F + lobe.lambda(lobe.outgoing);
        return lobe;
    }

    /// The roughness of an isotropic lobe with about as much light of further bounces.
    [[nodiscard]] static float round_roughness(const MaterialPoint& point, float roughness) {
        const Vec2 alpha = alpha_of(point, roughness);
        return std::sqrt(std::sqrt(0.5F * glm::dot(alpha, alpha)));
    }

    [[nodiscard]] Scattered scatter(const Vec3& incoming) const {
        if (incoming.z <= 0 || outgoing.z <= 0) return {};
        const Vec3 i = turned(incoming);
        const Vec3 h = glm::normalize(outgoing + i);
        const float seen = glm::dot(outgoing, h);
        const float x = h.x / alpha_.x;
        const float y = h.y / alpha_.y;
        const float sum = x * x + y * y + h.z * h.z;
        const float facets = 1.0F / (4.0F * pi * alpha_.x * alpha_.y * outgoing.z * sum * sum);
        const Vec3 fresnel = f0 + (Vec3(f90) - f0) * schlick_weight(seen);
        return {fresnel * (facets / (outer_ + lambda(i))), seen > 0 ? facets / outer_ : 0.0F};
    }
    [[nodiscard]] Vec3 sample(const Vec2& u) const {
        const Vec3 h = sample_ggx(outgoing, alpha_, u);
        const Vec3 i = 2.0F * glm::dot(outgoing, h) * h - outgoing;
        if (i.z <= 0) return Vec3(0);
        return {i.x * along_.x - i.y * along_.y, i.x * along_.y + i.y * along_.x, i.z};
    }

    Vec3 outgoing{0};  ///< with x along the stretch
    Vec3 f0{0};
    float f90 = 1;

private:
    [[nodiscard]] static Vec2 alpha_of(const MaterialPoint& point, float roughness) {
        const float across = ggx_alpha(roughness);
        const float strength = point.layers.anisotropy;
        return {across + (1.0F - across) * strength * strength, across};
    }
    /// A direction with x along the stretch.
    [[nodiscard]] Vec3 turned(const Vec3& v) const {
        return {v.x * along_.x + v.y * along_.y, v.y * along_.x - v.x * along_.y, v.z};
    }
    [[nodiscard]] float lambda(const Vec3& w) const {
        const float z2 = w.z * w.z;
        if (z2 == 0) return 1e30F;
        const float x = alpha_.x * w.x;
        const float y = alpha_.y * w.y;
        return 0.5F * (std::sqrt(1.0F + (x * x + y * y) / z2) - 1.0F);
    }

    Vec2 along_{1, 0}, alpha_{1};
    float outer_ = 1;  ///< 1 + lambda(outgoing)
};

}  // namespace raynest
