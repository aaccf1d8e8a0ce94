// Accepts connections on one address and passes their transports to Connections.
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

/// Listens on one address. Io thread only; must outlive the work of the io_context.
class Listener {
public:
    using Descriptors = Connections::Descriptors;

    /// Binds and listens; port 0 picks a free port. A Unix socket has the mode and group of
    /// `access` before any client can connect, and replaces the socket of a dead daemon. Fails with
    /// io_failed and the reason.
    static Result<std::unique_ptr<Listener>> open(asio::io_context& io, const Address& address,
                                                  const SocketAccess& access,
                                                  Connections& connections);
    ~Listener() { close(); }
    Listener(const Listener&) = delete;

    /// Starts accepting.
    void start() { accept_next(); }
    /// Stops accepting and removes a Unix socket's file; idempotent.
    void close();

    /// The address with the actual port.
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
    /// Accepts a waiting peer, with the spare descriptor if no other is left.
    SystemError accept_newcomer();
    void accept_later(const SystemError& error);
    void hand_on(Socket socket, Descriptors descriptors);

    asio::basic_socket_acceptor<asio::generic::stream_protocol> acceptor_;
    asio::steady_timer pause_;
    std::chrono::milliseconds backoff_{0};
    const MakeTransport make_transport_;
    Connections& connections_;
    std::string uri_;
    std::string socket_file_;   ///< path of a Unix socket's file
    Fd spare_;                  ///< freed to accept and refuse a peer when no descriptor is left
    Clock::time_point told_{};  ///< time of the last log line about that
};

}  // namespace raynest::server
