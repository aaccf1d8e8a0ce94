#include "server/scheduling/peers.h"

#include "server/ground/limited_log.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <string_view>
#include <utility>
#include <vector>

namespace raynest::server {
namespace {

struct Shortage {
    std::string_view name;
    std::string_view text;
    Metrics::Counter Metrics::*gave_way;
};

const Shortage& shortage(Resource resource) {
    static constexpr std::array<Shortage, 3> table = {{
        {"connections", "has no free connections", &Metrics::gave_way_connections},
        {"jobs", "takes no more requests", &Metrics::gave_way_jobs},
        {"memory", "has no free memory", &Metrics::gave_way_memory},
    }};
    return table[static_cast<std::size_t>(resource)];
}

std::string seconds_of(Clock::duration time) {
    return std::to_string(std::chrono::duration_cast<std::chrono::seconds>(time).count());
}

}  // namespace

void Peers::join(Peer& peer) {
    // Allocate first; then no step fails.
    std::set<Peer*> own{&peer};
    const auto to = peers_.try_emplace(peer.principal()).first;
    to->second.merge(own);
    peer.place.at_ = to;
    ++size_;
}

void Peers::move(Peer& peer, const std::string& principal) {
    if (!peer.place.at_) return;
    const auto to = peers_.try_emplace(principal).first;
    const auto from = *std::exchange(peer.place.at_, to);
    if (from == to) return;
    to->second.insert(from->second.extract(&peer));
    if (from->second.empty()) peers_.erase(from);
}

void Peers::leave(Peer& peer) {
    if (!peer.place.at_) return;
    const auto from = *std::exchange(peer.place.at_, std::nullopt);
    size_ -= from->second.erase(&peer);
    if (from->second.empty()) peers_.erase(from);
}

std::size_t Peers::size_of(const std::string& principal) const {
    const auto of = peers_.find(principal);
    return of == peers_.end() ? 0 : of->second.size();
}

std::uint64_t Peers::held_by(const std::string& principal, Resource resource) const {
    const auto of = peers_.find(principal);
    std::uint64_t sum = 0;
    if (of != peers_.end())
        for (const Peer* peer : of->second) sum += peer->holds(resource);
    return sum;
}

std::uint64_t Peers::weight_of(const std::string& principal, Resource resource) const {
    const std::uint64_t peers = held_by(principal, resource);
    return resource == Resource::memory ? std::max(peers, budget_.held_by(principal)) : peers;
}

std::optional<Clock::duration> Peers::paused(const Peer& peer, Clock::time_point now) const {
    const auto since = peer.paused_since();
    if (!since || now - *since < std::chrono::milliseconds(limits_.give_way_ms))
        return std::nullopt;
    return now - *since;
}

Peers::Choice Peers::choose(Resource resource, const std::string& newcomer, Whose whose) const {
    const Clock::time_point now = now_();
    const std::uint64_t newcomer_holds = weight_of(newcomer, resource);
    Choice choice;
    std::uint64_t most = 0;
    for (const auto& [principal, peers] : peers_) {
        const bool is_own = principal == newcomer;
        if (!is_own && whose == Whose::own) continue;
        const std::uint64_t held = is_own ? newcomer_holds : weight_of(principal, resource);
        if (held < newcomer_holds) continue;
        Choice of;
        for (Peer* peer : peers) {
            const std::uint64_t bytes = peer->holds(resource);
            const auto time = bytes == 0 ? std::nullopt : paused(*peer, now);
            if (!time) continue;
            choice.held += bytes;
            if (of.peer == nullptr || *time > of.paused) of.peer = peer, of.paused = *time;
        }
        if (of.peer == nullptr || (choice.peer != nullptr && held <= most)) continue;
        most = held;
        choice.peer = of.peer;
        choice.paused = of.paused;
    }
    return choice;
}

bool Peers::make_room(Resource resource, const std::string& newcomer, std::uint64_t amount,
                      Whose whose) {
    const Shortage& what = shortage(resource);
    for (bool first = true; amount != 0; first = false) {
        const Choice choice = choose(resource, newcomer, whose);
        // Close no connection if all of them together do not hold enough.
        if (choice.peer == nullptr || (first && choice.held < amount)) return false;
        const std::uint64_t held = choice.peer->holds(resource);
        log_limited(LogLevel::warn, "gave_way", newcomer,
                    {{"principal", choice.peer->principal()},
                     {"short", std::string(what.name)},
                     {"held", std::to_string(held)},
                     {"paused_s", seconds_of(choice.paused)},
                     {"newcomer", newcomer}});
        ++(metrics_.*what.gave_way);
        const bool is_idle = choice.peer->holds(Resource::jobs) == 0;
        choice.peer->give_way({Code::slow_consumer,
                               "nothing moved on this connection for " + seconds_of(choice.paused) +
                                   " s and the daemon " + std::string(what.text) +
                                   ": it gave way to a newcomer; connect again" +
                                   (is_idle ? "" : ", and read answers as they come"),
                               0});
        amount -= std::min(amount, held);
    }
    return true;
}

std::optional<Budget::Lease> Peers::reserve(std::uint64_t bytes, const std::string& principal,
                                            Use use) {
    auto lease = budget_.reserve(bytes, principal, use);
    if (lease) return lease;
    drop_spares_();
    make_memory(bytes, principal, use);
    return budget_.reserve(bytes, principal, use);
}

void Peers::make_memory(std::uint64_t bytes, const std::string& newcomer, Use use) {
    if (bytes <= budget_.room(newcomer, use) ||
        bytes > budget_.room(newcomer, use, {.requests = reclaimable_bytes(newcomer)}))
        return;
    while (bytes > budget_.room(newcomer, use) && make_room(Resource::memory, newcomer)) {
    }
}

std::uint64_t Peers::reclaimable_bytes(const std::string& newcomer) const {
    return choose(Resource::memory, newcomer, Whose::everybodys).held;
}

void Peers::dismiss(const std::string& why) {
    const Clock::time_point now = now_();
    std::vector<Peer*> paused_ones;
    for (const auto& [principal, peers] : peers_)
        for (Peer* peer : peers)
            if (paused(*peer, now)) paused_ones.push_back(peer);
    for (Peer* peer : paused_ones) {
        ++metrics_.gave_way_draining;
        log_limited(LogLevel::warn, "gave_way", peer->principal(),
                    {{"principal", peer->principal()}, {"short", "time"}});
        peer->give_way({Code::draining, why, 0});
    }
}

}  // namespace raynest::server
