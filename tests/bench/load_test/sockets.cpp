#include "tests/bench/load_test/sockets.h"

#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <string>

namespace raynest::client {
namespace {

tl::unexpected<Failure> failed(const char* call) {
    return fail(Exit::failed, std::string(call) + ": " + std::strerror(errno));
}

bool is_unix(int socket) {
    sockaddr_storage name{};
    socklen_t size = sizeof name;
    return getsockname(socket, reinterpret_cast<sockaddr*>(&name), &size) == 0 &&
           name.ss_family == AF_UNIX;
}

Result<void> add_unix_pair(SocketPairs& pairs) {
    std::array<int, 2> ends{};
    if (socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends.data()) != 0)
        return failed("socketpair");
    pairs.near.emplace_back(ends[0]);
    pairs.far.emplace_back(ends[1]);
    return {};
}

/// Listens on a free loopback port; sets `name` to its address.
Result<Descriptor> listen_on_loopback(sockaddr_in& name) {
    Descriptor listener(socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
    name.sin_family = AF_INET;
    name.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    auto* generic = reinterpret_cast<sockaddr*>(&name);
    socklen_t size = sizeof name;
    if (bind(listener.number(), generic, size) != 0 || listen(listener.number(), 16) != 0 ||
        getsockname(listener.number(), generic, &size) != 0)
        return failed("listen");
    return listener;
}

Result<void> add_tcp_pair(SocketPairs& pairs, const Descriptor& listener, const sockaddr_in& name) {
    Descriptor near(socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
    if (connect(near.number(), reinterpret_cast<const sockaddr*>(&name), sizeof name) != 0)
        return failed("connect");
    Descriptor far(accept4(listener.number(), nullptr, nullptr, SOCK_CLOEXEC));
    if (far.number() < 0) return failed("accept");
    for (const Descriptor* end : {&near, &far}) {
        const int on = 1;
        (void)setsockopt(end->number(), IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
    }
    pairs.near.push_back(std::move(near));
    pairs.far.push_back(std::move(far));
    return {};
}

}  // namespace

Result<SocketPairs> connect_pairs(int like, std::size_t count) {
    SocketPairs pairs;
    Descriptor listener;
    sockaddr_in name{};
    const bool use_unix = is_unix(like);
    if (!use_unix) {
        auto listening = listen_on_loopback(name);
        if (!listening) return tl::unexpected<Failure>(listening.error());
        listener = std::move(*listening);
    }
    for (std::size_t i = 0; i < count; ++i) {
        const auto added = use_unix ? add_unix_pair(pairs) : add_tcp_pair(pairs, listener, name);
        if (!added) return tl::unexpected<Failure>(added.error());
    }
    return pairs;
}

}  // namespace raynest::client
