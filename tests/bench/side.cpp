#include "tests/bench/side.h"

#include <algorithm>
#include <cstddef>
#include <limits>
#include <utility>

namespace raynest::bench {

CounterMode counter_mode(const std::string& word) {
    return word == "total" ? counters_total : word == "level" ? counters_by_level : counters_none;
}

Side make_own_side(Label label, const Workload& workload, const KernelSelector& selector,
                   std::span<const Ray> rays, Query query, std::uint32_t hits_max) {
    Side side;
    side.label = std::move(label);
    // Any intersector named after alpha asks the same question: alpha_mask and its controls.
    side.masks = side.label.intersector.find("alpha") != std::string::npos;
    side.answers =
        std::make_unique<Answers>(query, static_cast<std::uint32_t>(rays.size()), hits_max);
    const SceneView& scene = workload.scene->view();
    const CounterMode mode = counter_mode(side.label.counters);
    const std::uint32_t sets = mode == counters_by_level ? scene.objects[scene.root].levels
                                                         : static_cast<std::uint32_t>(mode);
    side.trace = [&view = scene, selector, rays, sets, answers = side.answers.get()](
                     std::uint32_t first, std::uint32_t count) {
        static thread_local std::vector<Counters> counters;
        counters.resize(std::max<std::size_t>(counters.size(), std::size_t{count} * sets));
        const TraceCall call{&view,
                             nullptr,
                             rays.data() + first,
                             count,
                             answers->hits_max,
                             0xFFFFFFFFU,
                             0,
                             answers->hits.data() + std::size_t{first} * answers->hits_max,
                             answers->counts.data() + first,
                             sets == 0 ? nullptr : counters.data(),
                             nullptr};
        selector.function(selector.choose(rays.subspan(first, count), view))(&call);
    };
    return side;
}

Result<Side> make_peer_side(PeerLibrary& library, const PeerForm& form, const Workload& workload,
                            std::span<const Ray> rays, Query query, std::uint32_t hits_max) {
    auto peer = library.open(form, query, workload.scene->view());
    if (!peer) return tl::unexpected(peer.error());
    Side side;
    side.label.name = form.name;
    side.label.width = form.width;
    side.masks = form.masks;
    side.adjusted = library.assert_factor(query, form.width > 1);
    side.peer = std::move(*peer);
    side.answers =
        std::make_unique<Answers>(query, static_cast<std::uint32_t>(rays.size()), hits_max);
    side.trace = [peer = side.peer.get(), rays, answers = side.answers.get()](std::uint32_t first,
                                                                              std::uint32_t count) {
        peer->trace({rays.data() + first, count, answers->hits_max,
                     answers->hits.data() + std::size_t{first} * answers->hits_max,
                     answers->counts.data() + first});
    };
    return side;
}

void answer(Side& side, std::uint32_t ray_count) {
    constexpr double any = std::numeric_limits<double>::infinity();
    run_lap({side.trace, side.label.threads}, ray_count, any);
    if (side.peer == nullptr) return;
    for (std::size_t ray = 0; ray < side.answers->counts.size(); ++ray) {
        const auto hits = side.answers->of(ray);
        const auto first = static_cast<std::size_t>(hits.data() - side.answers->hits.data());
        side.peer->translate({side.answers->hits.data() + first, hits.size()});
    }
}

}  // namespace raynest::bench
