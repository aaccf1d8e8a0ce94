// `--integrator path`: light that reaches the camera over any number of bounces.
//
// Each vertex of a path draws one light (next-event estimation), and the two ways to find a light are
// weighted by multiple importance sampling. Russian roulette ends paths that carry little.
#pragma once

#include "engine/integrators/integrator.h"
#include "engine/integrators/lighting.h"
#include "engine/shading/placement.h"

namespace raynest {

class Path : public Integrator {
public:
    static constexpr std::string_view text =
        "path tracing: all light, over any number of bounces up to --depth";

    Path(const IntegratorScene& scene, const IntegratorSettings& settings)
        : Path(scene, settings, settings.depth) {}

    [[nodiscard]] bool render(const SampleRange& range, RayCaster& caster, Wavefront& arrays,
                              std::span<FilmSample> out) const override;
    [[nodiscard]] std::vector<std::string> notes() const override { return lighting_.notes(); }

protected:
    Path(const IntegratorScene& scene, const IntegratorSettings& settings, std::uint32_t depth);

private:
    struct State;
    struct Step;
    void shade(const Ray& ray, const HitRecord& hit, const Sampler& sampler, std::uint32_t bounce,
               PlacementCache& placements, State& state, Step& step) const;
    void leave(const Ray& ray, std::uint32_t bounce, State& state) const;

    const ColumnSource scene_;
    const ShadingView view_;
    const Lighting lighting_;
    const std::uint32_t depth_;
};

}  // namespace raynest
