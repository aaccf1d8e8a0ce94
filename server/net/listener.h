// Accepts connections on one address and passes their sockets on.
#pragma once

#include "engine/result.h"
#include "engine/system/child_process.h"
#include "server/ground/address.h"
#include "server/net/asio.h"
#include "server/net/descriptors.h"

#include <chrono>
#include <functional>
#include <memory>
#include <string>
#include <string_view>

namespace raynest::server {

/// Listens on one address. Io thread only; must outlive the work of the io_context.
class Listener {
public:
    /// Takes over an accepted socket.
    using Accept = std::function<void(Socket, Descriptors)>;

    /// Binds and listens; port 0 picks a free port. `option` named the address. A Unix socket has
    /// the mode and group of `access` before any client can connect, and replaces the socket of a
    /// dead daemon. An address with a descriptor takes that socket over; its peers then wait in its
    /// queue while no daemon runs. Fails with io_failed and the reason.
    static Result<std::unique_ptr<Listener>> open(asio::io_context& io, const Address& address,
                                                  std::string_view option,
                                                  const SocketAccess& access, Accept accept);
    ~Listener() { close(); }
    Listener(const Listener&) = delete;

    void start() { accept_next(); }
    /// Stops accepting and removes a Unix socket's file, if the socket was made here; idempotent.
    void close();

    /// Stops accepting for good, and leaves the socket and its file to a process that has it, too.
    void leave() {
        socket_file_.clear();
        close();
    }
    /// Gives the file of a Unix socket that a daemon before has made this mode and group; close()
    /// removes it from now on. Fails with io_failed, and the file is as it was.
    Result<void> take_file(const SocketAccess& access);
    [[nodiscard]] int descriptor() { return acceptor_.native_handle(); }
    /// True if close() removes the file of a Unix socket.
    [[nodiscard]] bool has_file() const { return !socket_file_.empty(); }

    /// The address with the actual port.
    [[nodiscard]] std::string uri() const { return to_uri(address_); }
    [[nodiscard]] const Address& address() const { return address_; }

private:
    using Clock = std::chrono::steady_clock;
    Listener(asio::io_context& io, Accept accept)
        : acceptor_(io),
          pause_(io),
          accept_(std::move(accept)) {}
    void accept_next();
    void accepted(const SystemError& error, Socket socket);
    /// Accepts a waiting peer, with the spare descriptor if no other is left.
    SystemError accept_newcomer();
    void accept_later(const SystemError& error);
    void hand_on(Socket socket, Descriptors descriptors);
    /// Logs that descriptors are used up, at most once a second.
    void log_shortage();

    asio::basic_socket_acceptor<asio::generic::stream_protocol> acceptor_;
    asio::steady_timer pause_;
    std::chrono::milliseconds backoff_{0};
    const Accept accept_;
    Address address_;
    std::string socket_file_;   ///< path of a Unix socket's file
    Fd spare_;                  ///< freed to accept and refuse a peer when no descriptor is left
    Clock::time_point told_{};  ///< time of the last log line about that
};

}  // namespace raynest::server
