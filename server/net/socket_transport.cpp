#include "server/net/socket_transport.h"

#include "protocol/keep_alive.h"
#include "server/security/user_namespace.h"

#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <utility>

namespace raynest::server {
namespace {

/// Maximum bytes that a read waits for. Waking up for every segment costs up to twice the CPU time
/// of a stream if the reader keeps up with the sender.
constexpr std::size_t wanted_max = 128 << 10;

/// Time without an answer after which a peer may be dead. Keep-alive probes (protocol/keep_alive.h)
/// find a dead peer only while no bytes wait to be sent; otherwise TCP gives up after a quarter of
/// an hour. A live peer with a full window answers window probes.
constexpr std::uint32_t silence_ms_max = 20'000;
/// Number of unanswered window probes in a row that shows a dead peer.
constexpr int probes_max = 3;

/// Bytes of an IPv6 address that name its network.
constexpr std::ptrdiff_t network_bytes = 8;

PeerIdentity::Place place_of(uid_t user) {
    // First: in a namespace without any mapping the daemon's own user has that number too.
    if (is_unknown_user(user)) return PeerIdentity::Place::unknown_user;
    const bool is_own = user == 0 || user == geteuid();
    return is_own ? PeerIdentity::Place::own_user : PeerIdentity::Place::other_user;
}

}  // namespace

std::optional<asio::ip::address> remote_address(Socket& socket) {
    SystemError error;
    const auto endpoint = socket.remote_endpoint(error);
    asio::ip::tcp::endpoint tcp;
    const int family = error ? AF_UNSPEC : endpoint.protocol().family();
    if ((family != AF_INET && family != AF_INET6) || endpoint.size() > tcp.capacity())
        return std::nullopt;
    std::copy_n(reinterpret_cast<const char*>(endpoint.data()), endpoint.size(),
                reinterpret_cast<char*>(tcp.data()));
    const auto ip = tcp.address();
    if (!ip.is_v6() || !ip.to_v6().is_v4_mapped()) return ip;
    return asio::ip::make_address_v4(asio::ip::v4_mapped, ip.to_v6());
}

PeerIdentity identity_of(Socket& socket) {
    ucred peer{};
    socklen_t size = sizeof peer;
    sockaddr_storage address{};
    socklen_t address_size = sizeof address;
    auto* generic = reinterpret_cast<sockaddr*>(&address);
    if (getsockname(socket.native_handle(), generic, &address_size) == 0 &&
        address.ss_family == AF_UNIX &&
        getsockopt(socket.native_handle(), SOL_SOCKET, SO_PEERCRED, &peer, &size) == 0)
        return {"uid:" + std::to_string(peer.uid), place_of(peer.uid), "unix"};
    const auto ip = remote_address(socket);
    return ip ? identity_of(*ip) : PeerIdentity{"unknown", PeerIdentity::Place::remote};
}

PeerIdentity identity_of(asio::ip::address address) {
    using Place = PeerIdentity::Place;
    if (address.is_v6() && address.to_v6().is_v4_mapped())
        address = asio::ip::make_address_v4(asio::ip::v4_mapped, address.to_v6());
    if (address.is_loopback()) return {"127.0.0.1"};
    if (address.is_v4()) return {address.to_string(), Place::remote};
    // A network card may take each address of its /64: as principals of their own they could fill
    // every table.
    auto bytes = address.to_v6().to_bytes();
    std::fill(bytes.begin() + network_bytes, bytes.end(), std::uint8_t{0});
    PeerIdentity peer{asio::ip::address_v6(bytes).to_string() + "/64", Place::remote};
    peer.address = address.to_string();
    return peer;
}

bool peer_is_lost(int descriptor) {
    tcp_info info{};
    socklen_t size = sizeof info;
    if (getsockopt(descriptor, IPPROTO_TCP, TCP_INFO, &info, &size) != 0) return false;
    const std::uint32_t silence_ms = info.tcpi_last_ack_recv;
    if (silence_ms < silence_ms_max) return false;
    // Compare with the retransmission timeout tcpi_rto, which doubles each time: a live peer
    // answers each retransmission.
    if (info.tcpi_unacked != 0) return silence_ms > info.tcpi_rto / 1000 * 3 / 2;
    return info.tcpi_probes >= probes_max;
}

bool peer_has_left(int descriptor) {
    pollfd look{descriptor, POLLRDHUP, 0};
    return ::poll(&look, 1, 0) > 0;
}

SocketTransport::SocketTransport(Socket socket)
    : socket_(std::move(socket)),
      peer_(identity_of(socket_)) {
    protocol::tune_tcp(socket_.native_handle());
    SystemError ignored;
    socket_.non_blocking(true, ignored);
}

// read() and write() return Asio's awaitable: a coroutine of their own would cost another frame.

asio::awaitable<std::size_t> SocketTransport::read(const ReadBuffers& buffers, std::size_t wanted,
                                                   SystemError& error) {
    wanted = std::min(wanted, wanted_max);
    if (wanted != wanted_) {
        wanted_ = wanted;
        const int mark = static_cast<int>(wanted);
        // Ignore failure: Unix sockets lack this option, and it only saves time.
        (void)setsockopt(socket_.native_handle(), SOL_SOCKET, SO_RCVLOWAT, &mark, sizeof mark);
    }
    return socket_.async_read_some(buffers, asio::redirect_error(asio::use_awaitable, error));
}

asio::awaitable<std::size_t> SocketTransport::write(const WriteBatch::Rest& rest,
                                                    SystemError& error) {
    return socket_.async_write_some(rest, asio::redirect_error(asio::use_awaitable, error));
}

std::size_t SocketTransport::write_now(const WriteBatch::Rest& rest) {
    SystemError ignored;
    return socket_.write_some(rest, ignored);
}

asio::awaitable<void> SocketTransport::finish_writing() {
    SystemError ignored;
    socket_.shutdown(Socket::shutdown_send, ignored);
    co_return;
}

void SocketTransport::close() {
    SystemError ignored;
    socket_.close(ignored);
}

}  // namespace raynest::server
