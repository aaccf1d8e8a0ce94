// The GGX distribution of microfacets in the frame of a surface: +z is the normal, `alpha` is
// roughness squared.
//
// Masking is Smith's, correlated in height. Normals are sampled as they are seen (Heitz, "Sampling
// the GGX Distribution of Visible Normals", JCGT 2018, in the form of Dupuy and Benyoub, 2023).
#pragma once

#include "engine/shading/sampling.h"

#include <algorithm>
#include <cmath>

namespace raynest {

/// Below this roughness the numbers of a lobe lose their digits in float.
inline constexpr float roughness_min = 0.02F;

inline float ggx_alpha(float roughness) {
    const float r = std::clamp(roughness, roughness_min, 1.0F);
    return r * r;
}

/// Density of microfacet normals; written without 1 - cos^2, which would cancel near the normal.
inline float ggx_density(const Vec3& h, float alpha) {
    const float x = h.x / alpha;
    const float y = h.y / alpha;
    const float sum = x * x + y * y + h.z * h.z;
    return 1.0F / (pi * alpha * alpha * sum * sum);
}

/// Smith's Lambda.
inline float ggx_lambda(const Vec3& w, float alpha) {
    const float z2 = w.z * w.z;
    if (z2 == 0) return 1e30F;
    const float tangent2 = (w.x * w.x + w.y * w.y) / z2;
    return 0.5F * (std::sqrt(1.0F + alpha * alpha * tangent2) - 1.0F);
}

/// Share of the microfacets that both directions see; the directions may lie on either side.
inline float ggx_masking(const Vec3& o, const Vec3& i, float alpha) {
    return 1.0F / (1.0F + ggx_lambda(o, alpha) + ggx_lambda(i, alpha));
}

/// Density of the normals that sample_ggx() returns for `o` (o.z > 0).
inline float ggx_visible_density(const Vec3& o, const Vec3& h, float alpha) {
    const float seen = glm::dot(o, h);
    if (seen <= 0) return 0;
    return ggx_density(h, alpha) * seen / (o.z * (1.0F + ggx_lambda(o, alpha)));
}

/// A visible microfacet normal for the direction `o` (o.z > 0); `alpha` along x and along y.
inline Vec3 sample_ggx(const Vec3& o, const Vec2& alpha, const Vec2& u) {
    const Vec3 stretched = glm::normalize(Vec3(alpha.x * o.x, alpha.y * o.y, o.z));
    const float z = (1.0F - u.y) * (1.0F + stretched.z) - stretched.z;
    const float radius = std::sqrt(std::max(0.0F, 1.0F - z * z));
    const Vec3 cap(radius * circle(u.x), z);
    const Vec3 h = cap + stretched;
    return glm::normalize(Vec3(alpha.x * h.x, alpha.y * h.y, std::max(h.z, 1e-7F)));
}
inline Vec3 sample_ggx(const Vec3& o, float alpha, const Vec2& u) {
    return sample_ggx(o, Vec2(alpha), u);
}

/// Schlick's approximation of Fresnel's term.
inline float schlick_weight(float cosine) {
    const float m = std::clamp(1.0F - cosine, 0.0F, 1.0F);
    const float m2 = m * m;
    return m2 * m2 * m;
}
inline Vec3 schlick(const Vec3& f0, float cosine) {
    return f0 + (Vec3(1) - f0) * schlick_weight(cosine);
}

/// Reflected share at a smooth border; `eta` is the index beyond over the index on this side.
inline float fresnel_dielectric(float cosine, float eta) {
    const float c = std::clamp(std::abs(cosine), 0.0F, 1.0F);
    const float sine2 = (1.0F - c * c) / (eta * eta);
    if (sine2 >= 1) return 1;
    const float beyond = std::sqrt(1.0F - sine2);
    const float parallel = (eta * c - beyond) / (eta * c + beyond);
    const float across = (c - eta * beyond) / (c + eta * beyond);
    return 0.5F * (parallel * parallel + across * across);
}

}  // namespace raynest
