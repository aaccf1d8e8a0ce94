#include "server/jobs/scene_poser.h"

#include "server/jobs/edit_memory.h"
#include "server/scheduling/fair_thread_pool.h"
#include "server/scheduling/peers.h"

#include <algorithm>
#include <exception>
#include <utility>

namespace raynest::server {

/// The result of a task.
struct ScenePoser::Made {
    Budget::Lease lease;  ///< of the result and of one copy
    Reply<std::shared_ptr<const Snapshot>> snapshot = nullptr;
};

ScenePoser::Kept::iterator ScenePoser::place_of(const std::string& principal,
                                                const std::string& digest, const Moment& moment) {
    return std::ranges::find_if(kept_, [&](const Posed& posed) {
        return posed.principal == principal && posed.digest == digest && posed.moment == moment;
    });
}

Reply<NamedScene> ScenePoser::find(const NamedScene& base, std::string_view animation,
                                   double seconds, const Caller& caller) {
    const auto moment = find_moment(base.snapshot(), animation, seconds);
    if (!moment) return refuse(moment.error());
    const auto posed = place_of(caller.principal, base.snapshot().digest(), *moment);
    if (posed == kept_.end() || posed->held == nullptr) {
        wanted_ = Wanted{base, *moment};
        return refuse(Code::busy, "the scene is being posed; ask again");
    }
    posed->used = Clock::now();
    NamedScene found = base;
    found.held = posed->held;
    return found;
}

void ScenePoser::make(const Wanted& wanted, const std::string& principal,
                      std::weak_ptr<Ready> ready) {
    const Snapshot& scene = wanted.base.snapshot();
    if (const auto under_way = place_of(principal, scene.digest(), wanted.moment);
        under_way != kept_.end()) {
        under_way->waiting.push_back(std::move(ready));
        return;
    }
    drop_idle();
    drop_all_but(kept_max - 1, principal);
    auto made = std::make_shared<Made>();
    const std::uint64_t bytes = 2 * scene.bytes().size();
    auto lease = services_.peers.reserve(bytes, principal);
    if (!lease) {
        drop_all_but(0, principal);
        lease = services_.peers.reserve(bytes, principal);
    }
    if (!lease) {
        if (const auto waits = ready.lock()) (*waits)(Reply<void>(no_room(bytes, principal)));
        return;
    }
    made->lease = std::move(*lease);
    kept_.push_back({principal, scene.digest(), wanted.moment, nullptr});
    kept_.back().waiting.push_back(std::move(ready));
    services_.blocking.submit(principal, Priority::normal,
                              [this, principal, held = wanted.base.held, moment = wanted.moment,
                               made, posed = std::prev(kept_.end())] {
                                  try {
                                      pose_scene(*held->snapshot, moment, principal, *made);
                                  } catch (const std::exception& error) {
                                      made->snapshot =
                                          refuse(Code::resource_exhausted, error.what());
                                  }
                                  post_([this, posed, made] { done(posed, *made); });
                              });
}

tl::unexpected<protocol::Error> ScenePoser::no_room(std::uint64_t bytes,
                                                    const std::string& principal) const {
    return services_.budget.refuse("the scene at another time", bytes, principal,
                                   "start raynestd with a larger --memory");
}

void ScenePoser::pose_scene(const Snapshot& scene, const Moment& moment,
                            const std::string& principal, Made& made) const {
    EditMemory memory(services_.budget, principal, Use::passing, scene.bytes().size());
    auto snapshot = pose(scene, moment, memory.guard({}));
    made.lease.merge(memory.take());
    if (snapshot)
        made.snapshot = std::move(*snapshot);
    else if (memory.refused() != 0)
        made.snapshot = no_room(memory.refused(), principal);
    else
        made.snapshot = refuse(std::move(snapshot.error()));
}

void ScenePoser::done(Kept::iterator posed, Made& made) {
    const auto waiting = std::exchange(posed->waiting, {});
    Reply<void> result;
    if (made.snapshot) {
        made.lease.shrink(std::min(made.lease.bytes(), (*made.snapshot)->bytes().size()));
        posed->held =
            services_.scenes.with_memory(std::move(*made.snapshot), std::move(made.lease));
        posed->used = Clock::now();
    } else {
        kept_.erase(posed);
        result = tl::unexpected(std::move(made.snapshot.error()));
    }
    for (const auto& each : waiting)
        if (const auto waits = each.lock()) (*waits)(result);
}

void ScenePoser::drop_all_but(std::size_t most, const std::string& principal) {
    const auto is_idle = [&](const Posed& posed) {
        return posed.principal == principal && posed.held != nullptr;
    };
    auto idle = static_cast<std::size_t>(std::ranges::count_if(kept_, is_idle));
    for (auto at = kept_.begin(); at != kept_.end() && idle > most;) {
        if (!is_idle(*at)) {
            ++at;
            continue;
        }
        at = kept_.erase(at);
        --idle;
    }
}

std::uint64_t ScenePoser::held_by(const std::string& principal) const {
    std::uint64_t bytes = 0;
    for (const Posed& posed : kept_)
        if (posed.principal == principal && posed.held != nullptr)
            bytes += posed.held->lease.bytes();
    return bytes;
}

void ScenePoser::drop_idle() {
    const auto now = Clock::now();
    std::erase_if(kept_, [&](const Posed& posed) {
        return posed.held != nullptr && now - posed.used > kept_time;
    });
}

}  // namespace raynest::server
