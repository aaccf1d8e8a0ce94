// The memory of scenes: each arena once, and what epochs share once.
#include "server/store/scene_store.h"

#include <memory>
#include <string>
#include <utility>

namespace raynest::server {

void SceneStore::forget_freed() {
    const auto is_freed = [](const auto& known) { return known.second.expired(); };
    std::erase_if(by_arena_, is_freed);
    std::erase_if(shared_leases_, is_freed);
}

Reply<std::shared_ptr<const HeldScene>> SceneStore::hold(std::shared_ptr<const Snapshot> snapshot,
                                                         const std::string& principal) {
    std::weak_ptr<const HeldScene>& known = by_arena_[snapshot->arena_id()];
    if (auto held = known.lock()) return held;

    const auto reserve = [&](std::uint64_t bytes) -> Reply<Budget::Lease> {
        auto lease = budget_.reserve(bytes, principal, Use::lasting);
        if (lease) return std::move(*lease);
        drop_spares();
        lease = budget_.reserve(bytes, principal, Use::lasting);
        if (lease) return std::move(*lease);
        return budget_.refuse("the scene", bytes, principal,
                              remedy(principal, "start raynestd with a larger --memory"));
    };
    std::shared_ptr<const Budget::Lease> shared;
    if (const auto& pages = snapshot->shared()) {
        std::weak_ptr<const Budget::Lease>& leased = shared_leases_[pages.get()];
        shared = leased.lock();
        if (!shared) {
            auto lease = reserve(pages->size());
            if (!lease) return tl::unexpected(std::move(lease.error()));
            leased = shared = std::make_shared<const Budget::Lease>(std::move(*lease));
        }
    }
    auto lease = reserve(snapshot->own_bytes());
    if (!lease) return tl::unexpected(std::move(lease.error()));
    const auto held = with_memory({std::move(snapshot), std::move(*lease), 0, std::move(shared)});
    known = held;
    return held;
}

std::shared_ptr<const HeldScene> SceneStore::with_memory(HeldScene scene) const {
    return {new HeldScene(std::move(scene)), [dispose = dispose_](const HeldScene* held) {
                auto freed = held->snapshot;
                delete held;
                if (freed && *dispose) (*dispose)(std::move(freed));
            }};
}

}  // namespace raynest::server
