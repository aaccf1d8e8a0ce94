#include "server/net/connections.h"

#include <new>
#include <utility>

namespace raynest::server {
namespace {

constexpr std::uint32_t retry_ms = 1000;

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
           " that --principal-connections-max allows; close one of them";
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
    if (full) {
        ++services_.metrics.connections_closed;
        return write_last_error(*transport, busy(std::move(*full)));
    }
    const auto session =
        std::make_shared<Session>(io_, std::move(transport), *this, services_, context_);
    try {
        sessions_.insert(session);
        services_.peers.join(*session);
        session->start();
    } catch (const std::bad_alloc&) {
        session->stop();
    }
}

Reply<Principal> Connections::authenticate(Session& session, const wire::Hello& hello) {
    auto principal = authenticator_(session.peer(), hello, services_.limits);
    if (!principal || principal->id == session.principal()) return principal;
    const std::uint64_t quota = principal->quota.connections;
    if (services_.peers.size_of(principal->id) >= quota)
        if (auto full = quota_full(principal->id, quota))
            return tl::unexpected(busy(std::move(*full)));
    services_.peers.move(session, principal->id);
    return principal;
}

void Connections::leave(const std::shared_ptr<Session>& session) {
    sessions_.erase(session);
    services_.peers.leave(*session);
}

// The next three functions iterate over a copy: sessions may leave while they are called.

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

}  // namespace raynest::server
