// All connections of the daemon: takes new ones in, learns who they are, ends them.
//
//   Listener ──accept()──► counted under the name that the transport knows
//   Session ──authenticate()──► counted under its principal, whose quota holds from now on
#pragma once

#include "server/net/session.h"

#include <memory>
#include <optional>
#include <string>
#include <unordered_set>

namespace raynest::server {

/// Io thread only.
class Connections {
public:
    /// Whether the process may open more files; a connection that took the last one is told so.
    enum class Descriptors { free, used_up };

    Connections(asio::io_context& io, const Services& services, const JobContext& context,
                Authenticator authenticator = server::authenticate)
        : io_(io),
          services_(services),
          context_(context),
          authenticator_(authenticator) {}
    Connections(const Connections&) = delete;

    /// Starts a session, or tells the peer that there is no place for it.
    void accept(std::unique_ptr<Transport> transport, Descriptors descriptors);
    [[nodiscard]] bool empty() const { return sessions_.empty(); }
    [[nodiscard]] std::size_t size() const { return sessions_.size(); }

    /// No new jobs; each connection closes when its running ones ended.
    void drain();
    /// Ends all connections with this error.
    void close_with_error(const protocol::Error& error);
    /// Closes those whose machine or network is gone.
    void close_lost();

    // For sessions.

    /// Decides who the session's peer is; BUSY if that principal has all connections of its quota.
    Reply<Principal> authenticate(Session& session, const wire::Hello& hello);
    void leave(const std::shared_ptr<Session>& session);

private:
    using Sessions = std::unordered_set<std::shared_ptr<Session>>;
    /// Each says why there is no place for one more connection, if nobody gives way to it: within
    /// the principal's quota, and in the daemon.
    std::optional<std::string> quota_full(const std::string& principal, std::uint64_t quota);
    std::optional<std::string> daemon_full(const std::string& principal, Descriptors descriptors);
    /// Counts a connection that is turned away.
    protocol::Error busy(std::string why);

    asio::io_context& io_;
    const Services& services_;
    const JobContext& context_;
    const Authenticator authenticator_;
    Sessions sessions_;
};

}  // namespace raynest::server
