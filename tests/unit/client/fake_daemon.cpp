#include "tests/unit/client/fake_daemon.h"

#include "tests/golden/examples.h"
#include "tests/patience.h"

#include <arpa/inet.h>
#include <doctest/doctest.h>
#include <ifaddrs.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cstring>
#include <stdexcept>

namespace raynest::client {

ClosedPort::ClosedPort(int family) : socket_(::socket(family, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    sockaddr_in6 six = {};
    six.sin6_family = AF_INET6;
    six.sin6_addr = in6addr_loopback;
    sockaddr_in four = {};
    four.sin_family = AF_INET;
    four.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    auto* const address =
        family == AF_INET6 ? reinterpret_cast<sockaddr*>(&six) : reinterpret_cast<sockaddr*>(&four);
    socklen_t size = family == AF_INET6 ? sizeof six : sizeof four;
    // Without IPv6, nobody listens on that port either.
    (void)::bind(socket_, address, size);
    (void)::getsockname(socket_, address, &size);
    const int port = ntohs(family == AF_INET6 ? six.sin6_port : four.sin_port);
    uri_ = (family == AF_INET6 ? "tcp://[::1]:" : "tcp://127.0.0.1:") +
           std::to_string(port == 0 ? 1 : port);
}

ClosedPort::~ClosedPort() {
    ::close(socket_);
}

std::pair<int, std::string> listen_somewhere() {
    static std::atomic<int> count = 0;
    const std::string path =
        "/tmp/raynest-test-" + std::to_string(::getpid()) + "-" + std::to_string(++count) + ".sock";
    ::unlink(path.c_str());
    sockaddr_un address = {};
    address.sun_family = AF_UNIX;
    std::memcpy(address.sun_path, path.c_str(), path.size() + 1);
    const int listener = ::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
    if (::bind(listener, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0 ||
        ::listen(listener, 4) != 0)
        throw std::runtime_error("cannot listen on " + path);
    return {listener, path};
}

std::pair<int, std::string> listen_on_every_address() {
    const int listener = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    sockaddr_in bound = {};
    socklen_t size = sizeof bound;
    if (::listen(listener, 4) != 0 ||  // without bind(): any address, any port
        ::getsockname(listener, reinterpret_cast<sockaddr*>(&bound), &size) != 0)
        throw std::runtime_error("cannot listen");
    return {listener, std::to_string(ntohs(bound.sin_port))};
}

std::string other_address() {
    ifaddrs* all = nullptr;
    if (::getifaddrs(&all) != 0) return "";
    std::string found;
    for (const ifaddrs* each = all; each != nullptr; each = each->ifa_next) {
        if (each->ifa_addr == nullptr || each->ifa_addr->sa_family != AF_INET) continue;
        sockaddr_in four = {};
        std::memcpy(&four, each->ifa_addr, sizeof four);
        if (ntohl(four.sin_addr.s_addr) >> 24 == 127) continue;
        std::array<char, INET_ADDRSTRLEN> text{};
        ::inet_ntop(AF_INET, &four.sin_addr, text.data(), text.size());
        found = text.data();
    }
    ::freeifaddrs(all);
    return found;
}

int accept_one(int listener) {
    pollfd waiting{listener, POLLIN, 0};
    const std::chrono::milliseconds time = test::patience();
    if (::poll(&waiting, 1, static_cast<int>(time.count())) != 1) return -1;
    return ::accept(listener, nullptr, nullptr);
}

Peer::~Peer() {
    ::close(socket_);
}

protocol::Frame Peer::receive() {
    std::byte byte;
    // Read byte by byte: slow, but nothing is read beyond the frame.
    while (!decoder_.complete()) {
        const std::span<std::byte> room = decoder_.room();
        std::byte* const out = room.empty() ? &byte : room.data();
        const ssize_t count = ::recv(socket_, out, room.empty() ? 1 : room.size(), 0);
        if (count <= 0) return {};
        if (room.empty()) {
            if (!decoder_.feed({&byte, 1})) return {};
        } else {
            decoder_.filled(static_cast<std::size_t>(count));
        }
    }
    return decoder_.take();
}

void Peer::send_bytes(std::span<const std::byte> bytes) {
    while (!bytes.empty()) {
        const ssize_t count = ::send(socket_, bytes.data(), bytes.size(), MSG_NOSIGNAL);
        if (count <= 0) return;
        bytes = bytes.subspan(static_cast<std::size_t>(count));
    }
}

void Peer::send(const protocol::Frame& frame) {
    send_bytes(golden::wire_bytes(frame));
}

void Peer::welcome(std::uint64_t window_bytes, std::uint32_t chunk_rays_max) {
    const protocol::Frame hello = receive();
    CHECK(protocol::open<wire::Hello>(hello).has_value());
    wire::WelcomeT welcome;
    welcome.version = 1;
    welcome.server = "fake";
    welcome.window_bytes = window_bytes;
    welcome.frame_bytes_max = 64U << 20;
    welcome.chunk_rays_max = chunk_rays_max;
    welcome.jobs_max = 8;
    send(hello.header.request_id, welcome);
}

FakeDaemon::FakeDaemon(std::function<void(Peer&)> script) {
    std::tie(listener_, path_) = listen_somewhere();
    thread_ = std::thread([this, script = std::move(script)] {
        const int socket = accept_one(listener_);
        if (socket < 0) return;
        Peer peer(socket);
        script(peer);
    });
}

FakeDaemon::~FakeDaemon() {
    thread_.join();
    ::close(listener_);
    ::unlink(path_.c_str());
}

}  // namespace raynest::client
