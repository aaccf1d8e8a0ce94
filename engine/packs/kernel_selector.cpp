#include "engine/packs/kernel_selector.h"

#include "engine/bvh/node.h"
#include "engine/geometry/coherence.h"
#include "engine/geometry/triangle.h"

#include <algorithm>

namespace raynest {
namespace {

constexpr std::size_t group_rays = 64;  // what the packet traversal takes at once
constexpr std::size_t sample_groups = 8;

/// Streams hide cache misses, so they pay for one large tree. Measured, stream over single, on
/// AVX-512 with 2 MiB of a core's own cache and on AVX2: terrain and cards, 17 to 145 MB, rays from
/// near by 0.91 to 1.07 and 1.07 to 1.20, rays from anywhere 1.5 and 1.6 to 1.7. Where a tree is
/// hardly larger than that cache there is little to hide (terrain of 1.0 MB, before single rays
/// looked at several nodes: 0.97 to 1.11; of 4.6 MB 1.05 to 1.24), and below instances trees are
/// small and the rays' states large: six scenes of two to four levels 0.65 to 1.0, but for 1.07 of
/// random rays in one of them.
constexpr std::uint64_t stream_tree_bytes = 4ULL << 20;

bool suits_stream(const ObjectRecord& root) {
    const std::uint64_t tree_bytes = root.node_count * std::uint64_t{sizeof(Node)} +
                                     root.block_count * std::uint64_t{sizeof(TriangleBlock)};
    return root.levels == 1 && tree_bytes >= stream_tree_bytes;
}

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

Result<KernelSelector> KernelSelector::make(const Variant& variant, Query query,
                                            Traversal traversal, CounterMode counters) {
    KernelSelector selector;
    const bool in_order = counters != counters_none ||
                          (!variant.outputs().empty() && traversal != traversal_reference);
    selector.named_ = in_order ? traversal_single : traversal;
    const auto& compiled = variant.code->trace;
    const TraceFunction single = compiled[traversal_single][query][0];
    // An intersector that decides about boxes has no packets: what is named so are single rays.
    if (selector.named_ == traversal_packet && compiled[traversal_packet][query][0] == single)
        selector.named_ = traversal_single;
    const bool open = selector.named_ == traversal_auto;
    if (open) {
        for (const Traversal each : {traversal_stream, traversal_packet}) {
            const TraceFunction function = compiled[each][query][0];
            if (function != single) selector.functions_[each] = function;
        }
    }
    const Traversal needed = open ? traversal_single : selector.named_;
    const auto function = find_function(variant, query, needed, counters);
    if (!function) return tl::unexpected(function.error());
    selector.functions_[needed] = *function;
    return selector;
}

Result<KernelSelector> KernelSelector::observing(const Variant& variant) {
    if (variant.code->observe == nullptr)
        return fail(ErrorCode::variant_unknown, "intersector '" + variant.name + "' on target " +
                                                    variant.target +
                                                    " was not compiled to be observed");
    KernelSelector selector;
    selector.functions_[traversal_single] = variant.code->observe;
    return selector;
}

Traversal KernelSelector::choose(std::span<const Ray> rays, const SceneView& scene) const {
    const auto compiled = [&](Traversal traversal) { return functions_[traversal] != nullptr; };
    if (named_ != traversal_auto) return named_;
    if (rays.size() < group_rays) return traversal_single;
    const ObjectRecord& root = scene.objects[scene.root];
    if (look_coherent(rays, root.bounds))
        return compiled(traversal_packet) ? traversal_packet : traversal_single;
    const bool stream = compiled(traversal_stream) && suits_stream(root);
    return stream ? traversal_stream : traversal_single;
}

}  // namespace raynest
