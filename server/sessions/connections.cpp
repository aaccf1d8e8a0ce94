#include "server/sessions/connections.h"

#include "server/ground/fair_share.h"
#include "server/ground/io_turn.h"
#include "server/store/scene_store.h"

#include <algorithm>
#include <new>
#include <string_view>
#include <utility>

namespace raynest::server {
namespace {

constexpr std::uint32_t retry_ms = 1000;

}  // namespace

protocol::Error Connections::busy(std::string why) {
    ++services_.metrics.connections_refused;
    return {Code::busy, "the daemon has no free connections" + std::move(why), retry_ms};
}

std::optional<std::string> Connections::share_full(const std::string& principal,
                                                   const PeerIdentity& peer) {
    const std::uint64_t held = greeted_of(principal);
    const std::uint64_t quota = services_.admission.quotas().of(principal).connections;
    const std::uint64_t most = services_.limits.connections_max;
    const std::uint64_t greeted = services_.peers.size() - greeting_.size();
    const bool has_share = peer.place == PeerIdentity::Place::own_user ||
                           fair_place(held, most - std::min(most, greeted));
    if ((held < quota && has_share) ||
        services_.peers.make_room(Resource::connections, principal, 1, Peers::Whose::own))
        return std::nullopt;
    const std::string who = " for " + principal + ", which has " + std::to_string(held);
    if (held < quota)
        return who + ", its share of --connections-max " + std::to_string(most) +
               " now; close one of them";
    return who + (services_.admission.quotas().is_own(principal, &Quota::connections)
                      ? ", all of its quota; close one of them, or ask an administrator for more: "
                        "raynest admin quota " +
                            principal + " connections=N"
                      : ", all that --principal-connections-max allows; close one of them");
}

std::optional<std::string> Connections::daemon_full(const std::string& principal,
                                                    Descriptors descriptors) {
    if (descriptors != Descriptors::free) {
        // The room is for the next one: this one would keep a reserved descriptor. No newcomer
        // gives way: one of a crowd would be cut before it is read.
        services_.peers.make_room(Resource::connections, principal);
        return ": its " + descriptors_text();
    }
    const std::uint64_t most = services_.limits.connections_max;
    if (services_.peers.size() < most ||
        services_.peers.make_room(Resource::connections, principal) || end_oldest_greeting())
        return std::nullopt;
    return ": it has all " + std::to_string(most) + " that --connections-max allows";
}

void Connections::accept(std::unique_ptr<Transport> transport, Descriptors descriptors) {
    const std::string& name = transport->peer().name;
    auto full = daemon_full(name, descriptors);
    if (full && descriptors != Descriptors::used_up && has_reserved_place(transport->peer()))
        full.reset();
    if (full) {
        ++services_.metrics.connections_accepted;
        ++services_.metrics.connections_closed;
        return write_last_error(*transport, busy(std::move(*full)));
    }
    const auto session =
        std::make_shared<Session>(io_, std::move(transport), *this, services_, context_);
    ++services_.metrics.connections_accepted;  // from here on stop() counts the end
    try {
        sessions_.insert(session);
        services_.peers.join(*session);
        greeting_.emplace(session->number(), session);
        if (greeting_.size() > services_.limits.greeting_connections_max) end_oldest_greeting();
        session->start();
    } catch (const std::bad_alloc&) {
        session->stop();
    }
}

Reply<Principal> Connections::authenticate(Session& session, const wire::Hello& hello) {
    auto principal = authenticator_(session.peer(), hello, services_.limits);
    if (!principal) return principal;
    services_.admission.quotas().grant(principal->id, principal->quota);
    services_.scenes.quotas().grant(principal->id, principal->quota);
    if (auto full = share_full(principal->id, session.peer()))
        return tl::unexpected(busy(std::move(*full)));
    greeting_.erase(session.number());
    services_.peers.move(session, principal->id);
    return principal;
}

bool Connections::has_reserved_place(const PeerIdentity& peer) const {
    return peer.place == PeerIdentity::Place::own_user &&
           services_.peers.size() < services_.limits.connections_max + reserved_places;
}

std::size_t Connections::greeted_of(const std::string& principal) const {
    const auto waiting = std::ranges::count_if(
        greeting_, [&](const auto& entry) { return entry.second->principal() == principal; });
    return services_.peers.size_of(principal) - static_cast<std::size_t>(waiting);
}

bool Connections::end_oldest_greeting() {
    std::map<std::string_view, std::size_t> by_address;
    std::size_t most = 0;
    for (const auto& [number, session] : greeting_)
        most = std::max(most, ++by_address[session->peer().name]);
    const auto oldest = std::ranges::find_if(greeting_, [&](const auto& entry) {
        return by_address[entry.second->peer().name] == most;
    });
    if (oldest == greeting_.end()) return false;
    ++services_.metrics.greetings_gave_way;
    const auto session = oldest->second;
    session->stop();
    return true;
}

void Connections::leave(const std::shared_ptr<Session>& session) {
    sessions_.erase(session);
    greeting_.erase(session->number());
    services_.peers.leave(*session);
}

void Connections::drain(const std::string& why) {
    // The daemon asks again and again until all are gone.
    if (!drain_round_.expired()) return;
    const auto round = std::make_shared<const char>();
    drain_round_ = round;
    go_round([why, round](Session& session) { session.drain(why); });
}

void Connections::close_with_error(const protocol::Error& error) {
    go_round([error](Session& session) { session.close_with_error(error); });
}

std::vector<ConnectionRow> Connections::rows(std::uint64_t after) const {
    std::vector<ConnectionRow> rows;
    for (const auto& session : sessions_)
        if (session->number() > after) rows.push_back(session->row());
    std::ranges::sort(rows, {}, &ConnectionRow::number);
    return rows;
}

std::size_t Connections::kick(std::uint64_t number, const std::string& principal,
                              const protocol::Error& error) {
    const auto is_meant = [number, principal](const Session& session) {
        return number != 0 ? session.number() == number : session.principal() == principal;
    };
    const auto count =
        std::ranges::count_if(sessions_, [&](const auto& session) { return is_meant(*session); });
    go_round([this, is_meant, error](Session& session) {
        if (is_meant(session) && session.close_with_error(error)) ++services_.metrics.kicked;
    });
    return static_cast<std::size_t>(count);
}

void Connections::close_unless(
    const std::function<bool(const PeerIdentity&, const Principal*)>& valid,
    const protocol::Error& error, std::string_view rule) {
    go_round(
        [this, valid, error](Session& session) {
            const Principal* const principal = session.greeted() ? &session.identity() : nullptr;
            if (!valid(session.peer(), principal) && session.close_soon_with_error(error))
                ++services_.metrics.revoked;
        },
        rule);
}

void Connections::close_lost() {
    go_round([](Session& session) { session.stop_if_lost(); }, "lost");
}

void Connections::close_deserted() {
    go_round([](Session& session) { session.stop_if_deserted(); }, "deserted");
}

void Connections::go_round(std::function<void(Session&)> act, std::string_view rule) {
    const auto waits = [&](const Round& round) { return round.waits && round.rule == rule; };
    if (!rule.empty() && std::ranges::any_of(rounds_, waits)) return;
    rounds_.push_back({{}, std::move(act), rule, !rule.empty()});
    if (rule.empty()) rounds_.back().left = {sessions_.begin(), sessions_.end()};
    if (!is_going_) go_on();
}

void Connections::go_on() {
    // Where there is no memory to go on, the next round begins again.
    is_going_ = false;
    const Clock::time_point end = Clock::now() + turn_time;
    while (!rounds_.empty() && Clock::now() < end) {
        Round& round = rounds_.front();
        if (round.waits) round.left = {sessions_.begin(), sessions_.end()};
        round.waits = false;
        if (round.left.empty()) {
            rounds_.pop_front();
            continue;
        }
        const auto session = std::move(round.left.back());
        round.left.pop_back();
        try {
            round.act(*session);
        } catch (const std::bad_alloc&) {
            session->stop();  // it may be one that is to go
        }
    }
    if (rounds_.empty()) return;
    asio::post(io_, [this] { go_on(); });
    is_going_ = true;
}

}  // namespace raynest::server
