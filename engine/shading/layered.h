// glTF's material with what its extensions put around it. From the outside: a clear coat, the sheen
// of cloth, and then `standard` whose reflectance a thin film, KHR_materials_specular and a brushed
// surface change.
//
// A layer takes from what lies below it the light that it reflects itself, towards the viewer or
// towards the light, whichever is more: so no light is made, and both ways look the same. The
// diffuse base gets back what the coat reflects from below, by the coat's mean.
#pragma once

#include "engine/shading/anisotropic.h"
#include "engine/shading/iridescence.h"
#include "engine/shading/sheen.h"
#include "engine/shading/standard.h"

namespace raynest {

class Layered {
public:
    static constexpr bool lights_others = true;

    Layered(const MaterialPoint& point, const Vec3& outgoing)
        : base_(point, outgoing, reflectance(point, outgoing)),
          outgoing_(outgoing),
          sheen_colour_(point.layers.sheen),
          sheen_(std::max(outgoing.z, 1e-4F), point.layers.sheen_roughness),
          sheen_roughness_(point.layers.sheen_roughness),
          coat_frame_(basis_around(point.coat_normal)) {
        sheen_most_ = std::min(largest(sheen_colour_), 1.0F);
        sheen_seen_ = sheen_albedo(outgoing.z);
        const Vec3 seen = coat_frame_.to_local(outgoing);
        // The coat is on the outside of a solid.
        if (!point.inside && seen.z > 0) coat_ = std::clamp(point.layers.clearcoat, 0.0F, 1.0F);
        if (coat_ > 0) {
            const float roughness =
                std::clamp(point.layers.clearcoat_roughness, roughness_min, 1.0F);
            const AlbedoTables& tables = albedo_tables();
            coat_rows_ = AlbedoRows(tables, roughness);
            coat_lobe_ = {seen, ggx_alpha(roughness), Vec3(coat_f0)};
            coat_seen_ = coat_albedo(coat_rows_.at(seen.z));
            coat_mean_ =
                coat_albedo({tables.full_mean.at(roughness), tables.edge_mean.at(roughness)});
        }
        // At least a tenth for each layer, so that no lobe is sampled by chance alone.
        coat_share_ = coat_ > 0 ? std::clamp(coat_seen_, 0.1F, 0.8F) : 0.0F;
        sheen_share_ =
            sheen_most_ > 0 ? (1.0F - coat_share_) * std::clamp(sheen_seen_, 0.1F, 0.8F) : 0.0F;
    }

    [[nodiscard]] Vec3 emitted() const { return base_.emitted(); }
    [[nodiscard]] bool scatters() const { return base_.scatters(); }
    [[nodiscard]] Vec3 evaluate(const Vec3& i) const { return scatter(i).value; }
    [[nodiscard]] float density(const Vec3& i) const { return scatter(i).density; }

    [[nodiscard]] Scattered scatter(const Vec3& i) const {
        const auto parts = base_.parts(i);
        Vec3 sharp = parts.glossy + parts.clear;
        Vec3 broad = parts.broad;
        float density = (1.0F - coat_share_ - sheen_share_) * parts.density;
        if (sheen_most_ > 0) {
            const float left = 1.0F - std::max(sheen_seen_, sheen_albedo(std::abs(i.z)));
            sharp *= left;
            broad *= left;
            if (i.z > 0 && outgoing_.z > 0) {
                sharp += sheen_colour_ * sheen_.evaluate(outgoing_, i);
                density += sheen_share_ * i.z * (1.0F / pi);
            }
        }
        if (coat_ <= 0) return {sharp + broad, density};
        const Vec3 local = coat_frame_.to_local(i);
        const float lit = coat_albedo(coat_rows_.at(std::abs(local.z)));
        Vec3 value = sharp * (1.0F - std::max(coat_seen_, lit)) +
                     broad * ((1.0F - coat_seen_) * (1.0F - lit) / (1.0F - coat_mean_));
        if (i.z > 0) {
            const Scattered coat = coat_lobe_.scatter(local);
            value += coat_ * coat.value;
            density += coat_share_ * coat.density;
        }
        return {value, density};
    }
    [[nodiscard]] Vec3 sample(float choice, const Vec2& u) const {
        if (choice < coat_share_) {
            const Vec3 local = coat_lobe_.sample(u);
            const Vec3 i = coat_frame_.to_world(local);
            return local != Vec3(0) && i.z > 0 ? i : Vec3(0);
        }
        choice -= coat_share_;
        if (choice < sheen_share_) return sample_cosine(u);
        const float left = 1.0F - coat_share_ - sheen_share_;
        return base_.sample(std::min((choice - sheen_share_) / left, one_below), u);
    }

private:
    static constexpr float coat_f0 = 0.04F;  ///< for an index of 1.5, as the extension says

    [[nodiscard]] static Reflectance reflectance(const MaterialPoint& point, const Vec3& outgoing) {
        const Layers& layers = point.layers;
        const Vec3 border = border_reflectance(point.ior) * layers.specular_colour;
        Reflectance made{point.base_colour, glm::min(border, Vec3(1)) * layers.specular,
                         layers.specular};
        if (layers.iridescence <= 0) return made;
        for (Vec3* f0 : {&made.metal, &made.varnish}) {
            const Vec3 film = iridescent_f0(std::clamp(outgoing.z, 0.0F, 1.0F),
                                            layers.iridescence_ior, point.film_thickness, *f0);
            *f0 += layers.iridescence * (film - *f0);
        }
        return made;
    }
    /// Share of the light that the coat reflects in all.
    [[nodiscard]] float coat_albedo(const OneBounce& b) const {
        return coat_ * (coat_f0 * (b.full - b.edge) + b.edge);
    }
    /// Share of the light that the sheen reflects in its brightest colour.
    [[nodiscard]] float sheen_albedo(float cosine) const {
        return sheen_most_ > 0 ? sheen_most_ * raynest::sheen_albedo(cosine, sheen_roughness_)
                               : 0.0F;
    }

    MetallicRoughness<AnisotropicLobe> base_;
    Vec3 outgoing_;
    Vec3 sheen_colour_;
    SheenLobe sheen_;
    float sheen_roughness_;
    float sheen_most_ = 0, sheen_seen_ = 0, sheen_share_ = 0;
    Basis coat_frame_;
    AlbedoRows coat_rows_;
    GlossyLobe coat_lobe_{Vec3(0), 1, Vec3(0)};
    float coat_ = 0, coat_seen_ = 0, coat_mean_ = 0, coat_share_ = 0;
};

}  // namespace raynest
