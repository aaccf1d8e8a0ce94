// `--integrator path`: light that reaches the camera over any number of bounces.
//
// Each vertex of a path draws one light (next-event estimation), and the two ways to find a light
// are weighted by multiple importance sampling. Russian roulette ends paths that carry little.
#pragma once

#include "engine/integrators/integrator.h"
#include "engine/integrators/lighting.h"
#include "engine/shading/texture_batch.h"

namespace raynest {

class Path : public Integrator {
public:
    Path(const IntegratorScene& scene, const IntegratorSettings& settings)
        : Path(scene, settings, settings.depth) {}

    [[nodiscard]] bool render(const SampleRange& range, RayCaster& caster, Wavefront& arrays,
                              std::span<FilmSample> out) const override;
    [[nodiscard]] std::vector<std::string> notes() const override { return lighting_.notes(); }

protected:
    Path(const IntegratorScene& scene, const IntegratorSettings& settings, std::uint32_t depth);

private:
    struct State;
    struct Vertex;
    struct Memory;
    void locate(const Ray& ray, const HitRecord& hit, std::uint32_t bounce, Memory& memory,
                State& state, Vertex& vertex) const;
    void shade(const Ray& ray, const HitRecord& hit, const Sampler& sampler, std::uint32_t bounce,
               State& state, Vertex& vertex) const;
    void fetch_ahead(std::span<const HitRecord> hits, std::size_t at) const;
    void leave(const Ray& ray, std::uint32_t bounce, State& state) const;

    const ColumnSource scene_;
    const ShadingView view_;
    const Lighting lighting_;
    const TextureTable textures_;
    const std::uint32_t depth_;
    std::uint64_t number_ = 0;  ///< tells it from earlier ones at the same address
};

}  // namespace raynest
