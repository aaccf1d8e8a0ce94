// `--integrator ao`: how much of the sky above each point is open, within a distance.
#pragma once

#include "engine/integrators/integrator.h"
#include "engine/integrators/surface_point.h"

namespace raynest {

class Ao final : public Integrator {
public:
    Ao(const IntegratorScene& scene, const IntegratorSettings& settings)
        : scene_(scene.source),
          distance_(settings.ao_distance > 0
                        ? settings.ao_distance
                        : 0.1F * glm::length(scene.bounds.upper - scene.bounds.lower)) {}

    [[nodiscard]] bool render(const SampleRange& range, RayCaster& caster, Wavefront& arrays,
                              std::span<FilmSample> out) const override {
        if (!cast_camera_rays(range, caster, arrays)) return false;
        // One shadow ray per sample; those of misses are invalid and meet nothing.
        arrays.shadow_rays.assign(out.size(), Ray{});
        arrays.occluded.resize(out.size());
        for (std::size_t i = 0; i < out.size(); ++i) {
            const Ray& ray = arrays.rays[i];
            const HitRecord& hit = arrays.hits[i];
            describe_first_hit(scene_, ray, hit, out[i]);
            if (hit.hit == 0) continue;
            out[i].albedo = Vec3(1);
            if (out[i].normal == Vec3(0)) continue;
            const SurfacePoint point = surface_point(scene_, ray, hit);
            Ray& shadow = arrays.shadow_rays[i];
            shadow.direction = cosine_direction(
                out[i].normal, sampler_of(range, arrays, i).pair(sampler_dimensions));
            shadow.origin = point.origin(out[i].normal);
            shadow.tmax = distance_;
        }
        if (!caster.occluded(arrays.shadow_rays, arrays.occluded)) return false;
        for (std::size_t i = 0; i < out.size(); ++i)
            if (arrays.hits[i].hit != 0 && arrays.occluded[i] == 0) out[i].radiance = Vec3(1);
        return true;
    }

private:
    const ColumnSource scene_;
    const float distance_;
};

}  // namespace raynest
