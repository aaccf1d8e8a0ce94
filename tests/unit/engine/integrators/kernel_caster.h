// A RayCaster that calls the compiled functions of an intersector directly.
#pragma once

#include "engine/integrators/ray_caster.h"
#include "engine/packs/registry.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <memory>
#include <vector>

namespace raynest::test {

class KernelCaster final : public RayCaster {
public:
    explicit KernelCaster(const SceneView& scene, const char* variant = "opaque")
        : scene_(scene),
          variant_(variant) {
        auto registry = Registry::load({{}, "auto"});
        REQUIRE(registry);
        registry_ = *registry;
    }
    using RayCaster::closest;
    bool closest(std::span<const Ray> rays, std::span<HitRecord> hits) override {
        trace(query_closest, rays, hits);
        return true;
    }
    bool occluded(std::span<const Ray> rays, std::span<std::uint8_t> answers) override {
        std::vector<HitRecord> hits(rays.size());
        trace(query_any, rays, hits);
        std::ranges::transform(hits, answers.begin(), &HitRecord::hit);
        return true;
    }
    bool counted(std::span<const Ray>, std::span<HitRecord>, std::span<Counters>) override {
        return false;
    }
    bool observed(std::span<const Ray>, std::span<HitRecord>, const Observer&) override {
        return false;
    }

private:
    void trace(Query query, std::span<const Ray> all, std::span<HitRecord> hits) {
        const Variant& variant = *registry_->find(variant_);
        const auto function = find_function(variant, query, traversal_single);
        REQUIRE(function);
        TraceCall call{};
        call.scene = &scene_;
        call.mask = ~0U;
        call.hits_max = 1;
        call.rays = all.data();
        call.ray_count = static_cast<std::uint32_t>(all.size());
        call.hits = hits.data();
        REQUIRE((*function)(&call) == trace_ok);
    }
    const SceneView& scene_;
    const char* variant_;
    std::shared_ptr<const Registry> registry_;
};

}  // namespace raynest::test
