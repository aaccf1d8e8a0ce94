// All connections of the daemon: accepts, authenticates and closes them.
//
//   Listener ──accept()──► counted under the name that the transport gives the peer
//   Session ──authenticate()──► counted under its principal and that principal's quota
#pragma once

#include "server/administration.h"
#include "server/net/session.h"

#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <unordered_set>
#include <vector>

namespace raynest::server {

/// The set of sessions. Io thread only.
class Connections {
public:
    /// Tells whether the process has file descriptors left. A connection that got the last one is
    /// refused with that reason.
    enum class Descriptors { free, used_up };

    Connections(asio::io_context& io, const Services& services, const JobContext& context,
                Authenticator authenticator = server::authenticate)
        : io_(io),
          services_(services),
          context_(context),
          authenticator_(std::move(authenticator)) {}
    Connections(const Connections&) = delete;

    /// Starts a session, or sends the peer an error if there is no room for it.
    void accept(std::unique_ptr<Transport> transport, Descriptors descriptors);
    [[nodiscard]] bool empty() const { return sessions_.empty(); }
    [[nodiscard]] std::size_t size() const { return sessions_.size(); }

    /// Refuses new jobs; each connection closes when its running jobs have ended.
    void drain();
    /// Ends all connections with this error.
    void close_with_error(const protocol::Error& error);
    /// Closes connections whose machine or network is gone.
    void close_lost();
    /// Ends the connections for which `valid` returns false with this error.
    void close_unless(const std::function<bool(const Principal&)>& valid,
                      const protocol::Error& error);

    /// Lists the connections with numbers above `after`, by number.
    [[nodiscard]] std::vector<ConnectionRow> rows(std::uint64_t after) const;
    /// Ends one connection, or all of a principal, with this error. Returns their number.
    std::size_t kick(std::uint64_t number, const std::string& principal,
                     const protocol::Error& error);

    // Called by sessions.

    /// Identifies the session's peer. Fails with BUSY if the quota of its principal is used up.
    Reply<Principal> authenticate(Session& session, const wire::Hello& hello);
    void leave(const std::shared_ptr<Session>& session);

private:
    using Sessions = std::unordered_set<std::shared_ptr<Session>>;
    /// Makes room for one more connection of the principal. Returns the reason if its quota is used
    /// up and no peer gives way.
    std::optional<std::string> quota_full(const std::string& principal, std::uint64_t quota);
    /// Makes room for one more connection of the daemon. Returns the reason if it has too many and
    /// no peer gives way.
    std::optional<std::string> daemon_full(const std::string& principal, Descriptors descriptors);
    /// Closes the oldest session that waits for its Hello, of the address with most of them, if there
    /// are too many. Slow peers take such places away from each other, not from clients.
    void limit_greetings();
    /// True for a peer that finds a place even if the daemon has no free connections.
    [[nodiscard]] bool has_reserved_place(const PeerIdentity& peer) const;
    /// Counts a refused connection and returns its error.
    protocol::Error busy(std::string why);

    asio::io_context& io_;
    const Services& services_;
    const JobContext& context_;
    const Authenticator authenticator_;
    Sessions sessions_;
    std::map<std::uint64_t, std::shared_ptr<Session>> greeting_;  ///< not greeted yet, by number
};

}  // namespace raynest::server
