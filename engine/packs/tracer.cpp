#include "engine/packs/tracer.h"

namespace raynest {

Result<Tracer> Tracer::make(const Registry& registry, const SceneView& scene,
                            std::string_view intersector,
                            std::span<const std::pair<std::string, std::string>> settings) {
    const auto variant = registry.choose(intersector, scene);
    if (!variant) return tl::unexpected(variant.error());
    auto parsed = parse_settings(**variant, settings);
    if (!parsed) return tl::unexpected(parsed.error());
    const auto kernels = KernelSelector::make(**variant, query_closest, traversal_auto);
    if (!kernels) return tl::unexpected(kernels.error());
    return Tracer(scene, **variant, std::move(*parsed), *kernels);
}

Result<std::vector<HitRecord>> Tracer::closest_hits(std::span<const Ray> rays) const {
    std::vector<HitRecord> hits(rays.size());
    TraceCall call{};
    settings_.apply_to(call);
    call.scene = scene_;
    call.rays = rays.data();
    call.ray_count = static_cast<std::uint32_t>(rays.size());
    call.hits_max = 1;
    call.mask = 0xFFFFFFFFU;
    call.hits = hits.data();
    const TraceStatus status = kernels_.function(kernels_.choose(rays, *scene_))(&call);
    if (status == trace_ok) return hits;
    if (status == trace_out_of_memory)
        return fail(ErrorCode::out_of_memory, "the traversal ran out of memory");
    return fail(ErrorCode::internal, "intersector '" + variant_->name + "' on target " +
                                         variant_->target + " refused its call");
}

}  // namespace raynest
