// Accepts connections on one address and hands their transports on.
#pragma once

#include "engine/assets/child_process.h"
#include "engine/result.h"
#include "server/address.h"
#include "server/net/asio.h"
#include "server/net/connections.h"
#include "server/net/transports.h"

#include <chrono>
#include <memory>
#include <string>

namespace raynest::server {

/// Io thread only; must stay until the io_context has run out of work.
class Listener {
public:
    using Descriptors = Connections::Descriptors;

    /// Binds and listens; port 0 takes a free one. A Unix socket has the mode and group of `access`
    /// before anybody can connect, and one that a dead daemon left there is replaced. io_failed
    /// says what is in the way.
    static Result<std::unique_ptr<Listener>> open(asio::io_context& io, const Address& address,
                                                  const SocketAccess& access,
                                                  Connections& connections);
    ~Listener() { close(); }
    Listener(const Listener&) = delete;

    /// Starts accepting.
    void start() { accept_next(); }
    /// Stops accepting and removes a Unix socket's file; idempotent.
    void close();

    /// The address as it is now, with the port that was picked.
    [[nodiscard]] const std::string& uri() const { return uri_; }

private:
    using Clock = std::chrono::steady_clock;
    Listener(asio::io_context& io, MakeTransport make_transport, Connections& connections)
        : acceptor_(io),
          pause_(io),
          make_transport_(make_transport),
          connections_(connections) {}
    void accept_next();
    void accepted(const SystemError& error, Socket socket);
    /// Accepts a peer that waits, with the spare descriptor where there is no other.
    SystemError accept_newcomer();
    void accept_later(const SystemError& error);
    void hand_on(Socket socket, Descriptors descriptors);

    asio::basic_socket_acceptor<asio::generic::stream_protocol> acceptor_;
    asio::steady_timer pause_;
    std::chrono::milliseconds backoff_{0};
    const MakeTransport make_transport_;
    Connections& connections_;
    std::string uri_;
    std::string socket_file_;   ///< made for a Unix socket
    Fd spare_;                  ///< lets a peer that comes when no other is left hear of that
    Clock::time_point told_{};  ///< when the log last heard of that
};

}  // namespace raynest::server
