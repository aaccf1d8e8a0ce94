// All connections of the daemon: accepts, authenticates and closes them.
//
//   Listener ──accept()──► waits for its Hello, counted under the name that its transport gives it
//   Session ──authenticate()──► counted under its principal: its quota, and its share (fair_share.h)
#pragma once

#include "server/net/descriptors.h"
#include "server/requests/administration.h"
#include "server/security/authentication.h"
#include "server/sessions/session.h"

#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <unordered_set>
#include <vector>

namespace raynest::server {

/// The set of sessions. Io thread only.
class Connections {
public:
    Connections(asio::io_context& io, const Services& services, const JobContext& context,
                Authenticator authenticator = server::authenticate)
        : io_(io),
          services_(services),
          context_(context),
          authenticator_(std::move(authenticator)) {}
    Connections(const Connections&) = delete;

    /// Starts a session, or sends the peer an error if there is no room for it. Reserved
    /// descriptors are for the daemon's own user and root on the Unix socket; others are refused
    /// with that reason.
    void accept(std::unique_ptr<Transport> transport, Descriptors descriptors);
    [[nodiscard]] bool empty() const { return sessions_.empty(); }
    [[nodiscard]] std::size_t size() const { return sessions_.size(); }

    // These do it in turns of the io thread: a crowd takes long.

    /// Refuses new jobs; each connection closes when its running jobs have ended: with this
    /// message, or the usual one.
    void drain(const std::string& why = {});
    /// Ends all connections with this error.
    void close_with_error(const protocol::Error& error);
    /// Closes connections whose machine or network is gone.
    void close_lost();
    /// Closes connections whose peer has left while its request waits.
    void close_deserted();
    /// Ends the connections for which `valid` returns false with this error. One may cost the
    /// verification of a certificate; `valid` is also called later. The principal is null before Hello.
    /// `rule`, a literal, names what `valid` asks: of calls with one rule, those that come before the
    /// first has begun are one.
    void close_unless(const std::function<bool(const PeerIdentity&, const Principal*)>& valid,
                      const protocol::Error& error, std::string_view rule);

    /// Lists the connections with numbers above `after`, by number.
    [[nodiscard]] std::vector<ConnectionRow> rows(std::uint64_t after) const;
    /// Ends one connection, or all of a principal, with this error, in turns. Returns their number.
    std::size_t kick(std::uint64_t number, const std::string& principal,
                     const protocol::Error& error);

    // Called by sessions.

    /// Identifies the session's peer. Fails with BUSY if the quota of its principal is used up.
    Reply<Principal> authenticate(Session& session, const wire::Hello& hello);
    void leave(const std::shared_ptr<Session>& session);

private:
    using Sessions = std::unordered_set<std::shared_ptr<Session>>;
    /// Makes room for one more greeted connection of the principal, with this peer. Returns the
    /// reason if its quota or share is used up and none of its own gives way.
    std::optional<std::string> share_full(const std::string& principal, const PeerIdentity& peer);
    /// Makes room for one more connection of the daemon. Returns the reason if it has too many and
    /// no peer gives way.
    std::optional<std::string> daemon_full(const std::string& principal, Descriptors descriptors);
    /// Number of the principal's connections that are greeted.
    [[nodiscard]] std::size_t greeted_of(const std::string& principal) const;
    /// Closes the oldest session that waits for its Hello, of the addresses with most of them;
    /// false if none waits. Slow peers take such places away from each other, not from clients.
    bool end_oldest_greeting();
    /// True for a peer that finds a place even if the daemon has no free connections.
    [[nodiscard]] bool has_reserved_place(const PeerIdentity& peer) const;
    /// Something that is to be done with each session that was there when it began.
    struct Round {
        std::vector<std::shared_ptr<Session>> left;
        std::function<void(Session&)> act;
        std::string_view rule;
        bool waits = false;  ///< it takes the sessions that are there when it begins
    };
    /// Does something with every session, in turns. Nothing if a round of the same rule, a literal,
    /// has yet to begin; such a round meets sessions that come before it, too.
    void go_round(std::function<void(Session&)> act, std::string_view rule = {});
    /// Goes on for the time of a turn, and posts the rest.
    void go_on();
    /// Counts a refused connection and returns its error.
    protocol::Error busy(std::string why);

    asio::io_context& io_;
    const Services& services_;
    const JobContext& context_;
    const Authenticator authenticator_;
    Sessions sessions_;
    std::map<std::uint64_t, std::shared_ptr<Session>> greeting_;  ///< not greeted yet, by number
    std::deque<Round> rounds_;
    bool is_going_ = false;                  ///< go_on() is posted
    std::weak_ptr<const char> drain_round_;  ///< of the round that drains, while it lasts
};

}  // namespace raynest::server
