#include "engine/packs/tracer.h"

#include "engine/geometry/coherence.h"

#include <algorithm>

namespace raynest {
namespace {

constexpr std::size_t group_rays = 64;  // what the coherent traversal takes at once
constexpr std::size_t sample_groups = 8;

// Whether most groups of an even sample are coherent.
bool look_coherent(std::span<const Ray> rays, const Box& bounds) {
    const std::size_t groups = rays.size() / group_rays;
    const std::size_t sampled = std::min(groups, sample_groups);
    std::size_t coherent = 0;
    for (std::size_t i = 0; i < sampled; ++i) {
        const std::size_t group = i * groups / sampled;
        const auto members = rays.subspan(group * group_rays, group_rays);
        if (is_coherent(members, bounds)) ++coherent;
    }
    return 2 * coherent > sampled;
}

}  // namespace

Result<Tracer> Tracer::make(const Variant& variant, Query query, Precision precision,
                            Traversal traversal, bool counting) {
    Tracer tracer;
    const bool in_order =
        counting || (!variant.outputs().empty() && traversal != traversal_reference);
    tracer.named_ = in_order ? traversal_latency : traversal;
    const auto& compiled = variant.code->trace[precision];
    const TraceFunction latency = compiled[traversal_latency][query][0];
    // An intersector that decides about boxes has no packets: what is named so are single rays.
    if (tracer.named_ == traversal_coherent && compiled[traversal_coherent][query][0] == latency)
        tracer.named_ = traversal_latency;
    const bool open = tracer.named_ == traversal_auto;
    if (open) {
        for (const Traversal each : {traversal_batch, traversal_coherent}) {
            const TraceFunction function = compiled[each][query][0];
            if (function != latency) tracer.functions_[each] = function;
        }
    }
    const Traversal needed = open ? traversal_latency : tracer.named_;
    const auto function = find_function(variant, query, precision, needed, counting);
    if (!function) return tl::unexpected(function.error());
    tracer.functions_[needed] = *function;
    return tracer;
}

Traversal Tracer::choose(std::span<const Ray> rays, const SceneView& scene) const {
    const auto compiled = [&](Traversal traversal) { return functions_[traversal] != nullptr; };
    if (named_ != traversal_auto) return named_;
    if (rays.size() < group_rays) return traversal_latency;
    const ObjectRecord& root = scene.objects[scene.root];
    if (compiled(traversal_coherent) && look_coherent(rays, root.bounds)) return traversal_coherent;
    return compiled(traversal_batch) ? traversal_batch : traversal_latency;
}

}  // namespace raynest
