#include "server/net/connections.h"

#include <algorithm>
#include <new>
#include <string_view>
#include <utility>

namespace raynest::server {
namespace {

constexpr std::uint32_t retry_ms = 1000;
/// Connections beyond connections_max for the daemon's own user and root on a Unix socket, so that an
/// administrator can look at a full daemon.
constexpr std::uint64_t reserved_places = 4;

}  // namespace

protocol::Error Connections::busy(std::string why) {
    ++services_.metrics.connections_refused;
    return {Code::busy, "the daemon has no free connections" + std::move(why), retry_ms};
}

std::optional<std::string> Connections::quota_full(const std::string& principal,
                                                   std::uint64_t quota) {
    if (services_.peers.make_room(Resource::connections, principal, 1, Peers::Whose::own))
        return std::nullopt;
    return " for " + principal + ", which has all " + std::to_string(quota) +
           (services_.admission.quotas().is_own(principal, &Quota::connections)
                ? " of its quota; close one of them, or ask an administrator for more: raynest admin "
                  "quota " + principal + " connections=N"
                : " that --principal-connections-max allows; close one of them");
}

std::optional<std::string> Connections::daemon_full(const std::string& principal,
                                                    Descriptors descriptors) {
    const bool used_up = descriptors == Descriptors::used_up;
    const std::uint64_t most = services_.limits.connections_max;
    if ((!used_up && services_.peers.size() < most) ||
        services_.peers.make_room(Resource::connections, principal))
        return std::nullopt;
    return used_up ? ": its file descriptors are used up; raise LimitNOFILE or ulimit -n for it"
                   : ": it has all " + std::to_string(most) + " that --connections-max allows";
}

void Connections::accept(std::unique_ptr<Transport> transport, Descriptors descriptors) {
    ++services_.metrics.connections_accepted;
    const std::string& name = transport->peer().name;
    const std::uint64_t quota = services_.limits.principal_connections_max;
    auto full = services_.peers.size_of(name) >= quota ? quota_full(name, quota)
                                                       : daemon_full(name, descriptors);
    if (full && descriptors == Descriptors::free && has_reserved_place(transport->peer()))
        full.reset();
    if (full) {
        ++services_.metrics.connections_closed;
        return write_last_error(*transport, busy(std::move(*full)));
    }
    const auto session =
        std::make_shared<Session>(io_, std::move(transport), *this, services_, context_);
    try {
        sessions_.insert(session);
        services_.peers.join(*session);
        greeting_.emplace(session->number(), session);
        limit_greetings();
        session->start();
    } catch (const std::bad_alloc&) {
        session->stop();
    }
}

Reply<Principal> Connections::authenticate(Session& session, const wire::Hello& hello) {
    auto principal = authenticator_(session.peer(), hello, services_.limits);
    if (!principal) return principal;
    greeting_.erase(session.number());
    if (principal->id == session.principal()) return principal;
    services_.admission.quotas().grant(principal->id, principal->quota);
    services_.scenes.quotas().grant(principal->id, principal->quota);
    const std::uint64_t quota = services_.admission.quotas().of(principal->id).connections;
    if (services_.peers.size_of(principal->id) >= quota)
        if (auto full = quota_full(principal->id, quota))
            return tl::unexpected(busy(std::move(*full)));
    services_.peers.move(session, principal->id);
    return principal;
}

bool Connections::has_reserved_place(const PeerIdentity& peer) const {
    return peer.place == PeerIdentity::Place::own_user &&
           services_.peers.size() < services_.limits.connections_max + reserved_places;
}

void Connections::limit_greetings() {
    if (greeting_.size() <= services_.limits.greeting_connections_max) return;
    std::map<std::string_view, std::size_t> by_address;
    for (const auto& [number, session] : greeting_) ++by_address[session->peer().name];
    const auto most = std::ranges::max_element(
        by_address, {}, [](const auto& entry) { return entry.second; });
    const auto oldest = std::ranges::find_if(greeting_, [&](const auto& entry) {
        return entry.second->peer().name == most->first;
    });
    ++services_.metrics.greetings_gave_way;
    const auto session = oldest->second;
    session->stop();
}

void Connections::leave(const std::shared_ptr<Session>& session) {
    sessions_.erase(session);
    greeting_.erase(session->number());
    services_.peers.leave(*session);
}

// The functions below iterate over a copy: sessions may leave while they are called.

void Connections::drain() {
    const Sessions sessions = sessions_;
    for (const auto& session : sessions) session->drain();
}

void Connections::close_with_error(const protocol::Error& error) {
    const Sessions sessions = sessions_;
    for (const auto& session : sessions) session->close_with_error(error);
}

void Connections::close_lost() {
    const Sessions sessions = sessions_;
    for (const auto& session : sessions) session->stop_if_lost();
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
    std::size_t count = 0;
    const Sessions sessions = sessions_;
    for (const auto& session : sessions) {
        const bool meant = number != 0 ? session->number() == number
                                       : session->principal() == principal;
        if (!meant) continue;
        if (session->close_with_error(error)) ++services_.metrics.kicked;
        ++count;
    }
    return count;
}

void Connections::close_unless(const std::function<bool(const Principal&)>& valid,
                               const protocol::Error& error) {
    const Sessions sessions = sessions_;
    for (const auto& session : sessions)
        if (!valid(session->identity()) && session->close_with_error(error))
            ++services_.metrics.revoked;
}

}  // namespace raynest::server
