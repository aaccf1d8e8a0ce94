#include "server/jobs/scene_poser.h"

#include "server/jobs/edit_memory.h"
#include "server/scheduling/fair_thread_pool.h"
#include "server/scheduling/peers.h"
#include "server/store/late_velocities.h"

#include <algorithm>
#include <exception>
#include <utility>

namespace raynest::server {

/// The result of a task.
struct ScenePoser::Made {
    Budget::Lease lease;  ///< for the result and one copy
    Reply<std::shared_ptr<const Snapshot>> snapshot = nullptr;
    std::shared_ptr<const LateVelocities> velocities = nullptr;
    std::uint64_t bytes = 0;  ///< bytes of both
};

ScenePoser::Posed* ScenePoser::place_of(const std::string& principal, const std::string& arena,
                                        const Moment& moment) {
    const auto own = own_.find(principal);
    if (own == own_.end()) return nullptr;
    const auto posed = std::ranges::find_if(own->second.kept, [&](const Posed& each) {
        return each.arena == arena && each.moment == moment;
    });
    return posed == own->second.kept.end() ? nullptr : &*posed;
}

std::size_t ScenePoser::under_way(const std::string& principal) const {
    const auto own = own_.find(principal);
    if (own == own_.end()) return 0;
    return static_cast<std::size_t>(std::ranges::count(own->second.kept, nullptr, &Posed::held));
}

Reply<NamedScene> ScenePoser::find(const NamedScene& base, std::string_view animation,
                                   double seconds, const Caller& caller) {
    const auto moment = find_moment(base.snapshot(), animation, seconds);
    if (!moment) return refuse(moment.error());
    Posed* const posed = place_of(caller.principal, base.snapshot().arena_id(), *moment);
    if (posed == nullptr || posed->held == nullptr) {
        wanted_ = Wanted{base, *moment};
        return refuse(Code::busy, "the scene is being posed; ask again");
    }
    posed->used = Clock::now();
    NamedScene found = base;
    found.held = posed->held;
    found_.push_back(posed->held);
    return found;
}

void ScenePoser::make(const Wanted& wanted, const std::string& principal,
                      std::weak_ptr<Ready> ready) {
    const Snapshot& scene = wanted.base.snapshot();
    if (Posed* const same = place_of(principal, scene.arena_id(), wanted.moment)) {
        same->waiting.add(std::move(ready));
        return;
    }
    const std::size_t others = under_way(principal);
    if (others == kept_max) {
        own_[principal].queue.add(std::move(ready));
        return;
    }
    drop_idle();
    drop_all_but(kept_max - 1 - others, principal);
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
    Kept& kept = own_[principal].kept;
    kept.push_back({principal, scene.arena_id(), wanted.moment, nullptr});
    kept.back().waiting.add(std::move(ready));
    services_.blocking.submit(principal, Priority::normal,
                              [this, principal, held = wanted.base.held, moment = wanted.moment,
                               made, posed = std::prev(kept.end())] {
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
    if (snapshot) {
        made.velocities =
            std::make_shared<LateVelocities>(**snapshot, moment.animation, moment.seconds);
        made.bytes = (*snapshot)->bytes().size() + made.velocities->bytes();
        made.snapshot = std::move(*snapshot);
    } else if (memory.refused() != 0) {
        made.snapshot = no_room(memory.refused(), principal);
    } else {
        made.snapshot = refuse(std::move(snapshot.error()));
    }
}

void ScenePoser::done(Kept::iterator posed, Made& made) {
    const std::string principal = posed->principal;
    Waiters waiting = std::exchange(posed->waiting, {});
    Reply<void> result;
    std::shared_ptr<const HeldScene> held;  // those who wait for it find it, in whatever turn
    if (made.snapshot) {
        made.lease.shrink(std::min(made.lease.bytes(), made.bytes));
        posed->held = services_.scenes.with_memory(
            {std::move(*made.snapshot), std::move(made.lease), {}, std::move(made.velocities)});
        posed->used = Clock::now();
        held = posed->held;
    } else {
        own_[principal].kept.erase(posed);
        result = tl::unexpected(std::move(made.snapshot.error()));
    }
    waiting.wake_all(std::move(result), post_, std::move(held));
    // Each begins another, unless what it wants is there meanwhile.
    in_turns(post_, [this, principal] {
        const auto own = own_.find(principal);
        if (own == own_.end() || own->second.queue.empty() || under_way(principal) >= kept_max)
            return false;
        own->second.queue.wake_first({});
        return true;
    });
}

void ScenePoser::drop_all_but(std::size_t most, const std::string& principal) {
    const auto own = own_.find(principal);
    if (own == own_.end()) return;
    Kept& kept = own->second.kept;
    std::size_t idle = kept.size() - under_way(principal);
    for (auto at = kept.begin(); at != kept.end() && idle > most;) {
        if (at->is_in_use()) {
            ++at;
            continue;
        }
        at = kept.erase(at);
        --idle;
    }
}

std::uint64_t ScenePoser::held_by(const std::string& principal) const {
    std::uint64_t bytes = 0;
    if (const auto own = own_.find(principal); own != own_.end())
        for (const Posed& posed : own->second.kept)
            if (posed.held != nullptr) bytes += posed.held->lease.bytes();
    return bytes;
}

void ScenePoser::drop_idle(Clock::time_point now) {
    for (auto own = own_.begin(); own != own_.end();) {
        std::erase_if(own->second.kept, [&](const Posed& posed) {
            return !posed.is_in_use() && now - posed.used > kept_time;
        });
        const bool is_over = own->second.kept.empty() && own->second.queue.empty();
        own = is_over ? own_.erase(own) : std::next(own);
    }
}

}  // namespace raynest::server
