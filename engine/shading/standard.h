// glTF's metallic-roughness material, with transmission: a mixture of metal, of a varnished diffuse
// base, and of glass.
//
// The diffuse base gets the light that the varnish lets through, by the same tables, so that a
// white material reflects all light at any roughness, and is reciprocal.
#pragma once

#include "engine/shading/glass.h"
#include "engine/shading/glossy.h"
#include "engine/shading/material.h"

namespace raynest {

/// The share of light that metal and varnish reflect along the normal, and varnish at grazing
/// angles.
struct Reflectance {
    Vec3 metal, varnish;
    float grazing = 1;
};

/// Reflectance of a border with a medium of this index.
[[nodiscard]] inline float border_reflectance(float ior) {
    const float root = (ior - 1.0F) / (ior + 1.0F);
    return root * root;
}

/// The material with the glossy lobe that metal and varnish have in common.
template <class Glossy>
class MetallicRoughness {
public:
    MetallicRoughness(const MaterialPoint& point, const Vec3& outgoing,
                      const Reflectance& reflectance)
        : emission_(point.emission),
          smooth_(point.smooth),
          roughness_(std::clamp(point.roughness, roughness_min, 1.0F)),
          glass_{outgoing, roughness_, 1, false, Vec3(0), 1, 1} {
        const float metal = std::clamp(point.metallic, 0.0F, 1.0F);
        const float clear = (1.0F - metal) * std::clamp(point.transmission, 0.0F, 1.0F);
        const float varnish = 1.0F - metal - clear;
        const Vec3& f0 = reflectance.varnish;
        const float f90 = reflectance.grazing;
        const float round_roughness = Glossy::round_roughness(point, roughness_);

        const AlbedoTables& tables = albedo_tables();
        rows_ = AlbedoRows(tables, round_roughness);
        seen_ = rows_.at(outgoing.z);
        full_mean_ = tables.full_mean.at(round_roughness);
        const float edge_mean = tables.edge_mean.at(round_roughness);

        varnish_f0_ = f0;
        varnish_f90_ = f90;
        varnish_more_ = further_bounces(f0, full_mean_, f90);
        const Vec3 mean = varnish_albedo({full_mean_, edge_mean});
        base_ = varnish * point.base_colour / (pi * (Vec3(1) - mean));
        base_seen_ = Vec3(1) - varnish_albedo(seen_);
        more_ = (metal * further_bounces(reflectance.metal, full_mean_) + varnish * varnish_more_) /
                (pi * std::max(1.0F - full_mean_, 1e-6F));

        glossy_ = Glossy::of(point, outgoing, roughness_, metal * reflectance.metal + varnish * f0,
                             metal + varnish * f90);
        if (clear > 0) {
            const float eta = point.inside ? 1.0F / point.ior : point.ior;
            // A border between equal media bends nothing; a little keeps the half vector defined.
            glass_ = {outgoing, roughness_, std::abs(eta - 1) < 1e-3F ? 1.001F : eta, point.solid,
                      point.base_colour};
        }
        choose(clear, varnish * point.base_colour);
    }

    [[nodiscard]] Vec3 emitted() const { return emission_; }
    [[nodiscard]] bool scatters() const { return glossy_.outgoing.z > 0; }

    /// The light that each part of the material scatters, as Scattered, and the density of all.
    struct Parts {
        Vec3 glossy{0}, broad{0}, clear{0};
        float density = 0;
    };
    [[nodiscard]] Parts parts(const Vec3& i) const {
        Parts sum;
        if (i.z > 0) {
            const OneBounce lit = rows_.at(i.z);
            const Vec3 base =
                base_ * base_seen_ * (Vec3(1) - varnish_albedo(lit)) * lit_share(smooth_, i);
            const Scattered glossy = glossy_.scatter(i);
            sum.glossy = glossy.value;
            sum.broad = (base + more_ * ((1.0F - seen_.full) * (1.0F - lit.full))) * i.z;
            sum.density = glossy_share_ * glossy.density + broad_share_ * i.z * (1.0F / pi);
        }
        if (clear_ > 0) {
            sum.clear = clear_ * glass_.evaluate(i);
            sum.density += glass_share_ * glass_.density(i);
        }
        return sum;
    }
    [[nodiscard]] Vec3 sample(float choice, const Vec2& u) const {
        if (choice < glossy_share_) return glossy_.sample(u);
        choice -= glossy_share_;
        if (choice < broad_share_ || glass_share_ <= 0) return sample_cosine(u);
        return glass_.sample(std::min((choice - broad_share_) / glass_share_, one_below), u);
    }

private:
    /// Share that the varnish reflects in all, for a direction with these table entries.
    [[nodiscard]] Vec3 varnish_albedo(const OneBounce& b) const {
        return varnish_f0_ * (b.full - b.edge) + varnish_f90_ * b.edge +
               varnish_more_ * (1.0F - b.full);
    }

    /// Shares of the strategies, by what each part reflects of white light.
    void choose(float clear, const Vec3& base) {
        const Vec3 glossy = glossy_.f0 * (seen_.full - seen_.edge) + glossy_.f90 * seen_.edge;
        const Vec3 broad =
            base * base_seen_ + more_ * (pi * (1.0F - seen_.full) * (1.0F - full_mean_));
        // Where a surface absorbs all, any direction is as good.
        float a = largest(glossy);
        float b = largest(broad);
        const float sum = a + b + clear;
        clear_ = clear;
        if (!(sum > 0)) {
            broad_share_ = 1;
            return;
        }
        // At least a tenth each, so that no lobe is sampled by chance alone.
        if (glossy_.f90 > 0) a = std::max(a, 0.1F * sum);
        if (b > 0) b = std::max(b, 0.1F * sum);
        const float total = a + b + clear;
        glossy_share_ = a / total;
        broad_share_ = b / total;
        glass_share_ = clear / total;
    }

    Vec3 emission_, smooth_;
    float roughness_;
    AlbedoRows rows_;
    OneBounce seen_;
    float full_mean_ = 1;
    Vec3 varnish_f0_{0}, varnish_more_{0};
    float varnish_f90_ = 1;
    Vec3 base_{0}, base_seen_{0}, more_{0};
    Glossy glossy_{};
    GlassLobe glass_;
    float clear_ = 0, glossy_share_ = 0, broad_share_ = 0, glass_share_ = 0;
};

class Standard : public MetallicRoughness<GlossyLobe> {
public:
    static constexpr bool lights_others = true;

    Standard(const MaterialPoint& point, const Vec3& outgoing)
        : MetallicRoughness(point, outgoing,
                            {point.base_colour, Vec3(border_reflectance(point.ior))}) {}

    [[nodiscard]] Vec3 evaluate(const Vec3& i) const { return scatter(i).value; }
    [[nodiscard]] float density(const Vec3& i) const { return scatter(i).density; }
    [[nodiscard]] Scattered scatter(const Vec3& i) const {
        const Parts p = parts(i);
        return {p.glossy + p.broad + p.clear, p.density};
    }
};

}  // namespace raynest
