// All light of a scene and how integrators draw from it: lights of the file, triangles that emit,
// and what comes from far away.
//
// One light is drawn per point. Light from near and from far have half of the draws each, where
// both exist: near ones in proportion to their power (an alias table), far ones alike.
#pragma once

#include "engine/integrators/integrator.h"
#include "engine/shading/alias_table.h"
#include "engine/shading/light.h"
#include "engine/shading/sky.h"

#include <cstdint>
#include <string>
#include <vector>

namespace raynest {

/// With more of them, triangles are met by chance alone.
inline constexpr std::uint64_t emitting_triangles_max = 1U << 19;

class Lighting {
public:
    Lighting(const IntegratorScene& scene, const IntegratorSettings& settings);

    /// A direction in which the point may see a light; black where there is none.
    [[nodiscard]] LightSample sample(const Vec3& from, float choice, const Vec2& u) const;
    /// Fetches what sample(choice, u) reads of the surroundings, as Environment does.
    void fetch_guide(float choice, const Vec2& u) const {
        if (draws_surroundings(choice)) sky_.environment.fetch_guide(u);
    }
    void fetch_texels(float choice, const Vec2& u) const {
        if (draws_surroundings(choice)) sky_.environment.fetch_texels(u);
    }
    /// Light that comes from infinity, against `direction`, and the density with which sample()
    /// gives the direction.
    [[nodiscard]] Environment::View far(const Vec3& direction) const;
    /// The density with which sample() gives the direction in which a ray met a triangle that
    /// emits.
    [[nodiscard]] float triangle_density(const HitRecord& hit, float distance, float cosine) const;

    [[nodiscard]] bool empty() const { return near_.empty() && far_count() == 0; }
    [[nodiscard]] const std::vector<std::string>& notes() const { return notes_; }

private:
    /// A triangle in the world.
    struct EmittingTriangle {
        Vec3 corner, edge1, edge2;
        float lift;
        std::uint32_t object, triangle;
    };

    void add_far(const IntegratorSettings& settings);
    void find_triangles(const IntegratorScene& scene);
    class Walk;
    void add_triangles(std::uint32_t object, std::uint64_t path, const glm::dmat4x3& to_world);
    [[nodiscard]] std::size_t far_count() const {
        return far_lights_.size() + (sky_.environment.empty() ? 0U : 1U) + (has_sun_ ? 1U : 0U);
    }
    [[nodiscard]] float near_share() const {
        return near_.empty() ? 0.0F : far_count() == 0 ? 1.0F : 0.5F;
    }
    /// True if most likely sample(choice) looks at the surroundings: they are drawn last.
    [[nodiscard]] bool draws_surroundings(float choice) const {
        if (sky_.environment.empty()) return false;
        const auto count = static_cast<float>(far_count());
        return choice >= 1.0F - (1.0F - near_share()) / count;
    }
    [[nodiscard]] LightSample sample_near(const Vec3& from, float choice, const Vec2& u) const;
    [[nodiscard]] LightSample sample_far(const Vec3& from, float choice, const Vec2& u) const;
    /// What the surroundings show, with the sun before them.
    [[nodiscard]] Environment::View with_sun(Environment::View view, const Vec3& direction) const;
    [[nodiscard]] LightSample sample_triangle_light(const EmittingTriangle& triangle,
                                                    const Vec3& from, const Vec2& u) const;

    const ColumnSource source_;
    const ShadingView view_;
    std::vector<std::uint32_t> near_lights_, far_lights_;  ///< in ShadingView::lights
    std::vector<EmittingTriangle> triangles_;
    std::vector<float> material_brightness_;  ///< mean emission, one per material
    AliasTable near_;                         ///< near_lights_, then triangles_
    std::vector<float> weights_;              ///< weights for near_
    Sky sky_;
    bool has_sun_ = false;
    std::vector<std::string> notes_;
};

}  // namespace raynest
