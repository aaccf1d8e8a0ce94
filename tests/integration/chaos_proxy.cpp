#include "tests/integration/chaos_proxy.h"

#include "protocol/control.h"
#include "tests/patience.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <chrono>
#include <cstring>
#include <span>
#include <stdexcept>

namespace raynest::test {
namespace {

using std::chrono::milliseconds;

constexpr std::uint64_t delay_ms_max = 4;
constexpr std::uint64_t drip_bytes_max = 200;

int tcp_socket() {
    const int descriptor = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    if (descriptor < 0) throw std::runtime_error("the proxy has no socket left");
    const int one = 1;
    setsockopt(descriptor, IPPROTO_TCP, TCP_NODELAY, &one, sizeof one);
    return descriptor;
}

sockaddr_in loopback(std::uint16_t port) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(port);
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    return address;
}

bool send_all(int to, std::span<const std::byte> bytes) {
    while (!bytes.empty()) {
        const ssize_t sent = send(to, bytes.data(), bytes.size(), MSG_NOSIGNAL);
        if (sent <= 0) return false;
        bytes = bytes.subspan(static_cast<std::size_t>(sent));
    }
    return true;
}

/// Makes the next close() of the descriptor a reset.
void arm_reset(int descriptor) {
    const linger at_once{1, 0};
    setsockopt(descriptor, SOL_SOCKET, SO_LINGER, &at_once, sizeof at_once);
}

}  // namespace

std::string Point::name() const {
    constexpr std::array parts = {"header", "control", "bulk"};
    return protocol::message_name(static_cast<std::uint16_t>(message)) + " " +
           parts[static_cast<std::size_t>(part)];
}

std::string_view harm_name(Harm harm) {
    constexpr std::array<std::string_view, harm_count> names = {"delay", "drip",       "stall",
                                                                "cut",   "half_close", "reset"};
    return names[static_cast<std::size_t>(harm)];
}

ChaosProxy::ChaosProxy(std::uint16_t daemon_port, Point point, std::uint64_t seed)
    : point_(point),
      random_(seed),
      harm_(static_cast<Harm>(random_() % harm_count)),
      byte_(random_()),
      daemon_port_(daemon_port),
      listener_(tcp_socket()) {
    sockaddr_in address = loopback(0);
    socklen_t size = sizeof address;
    auto* name = reinterpret_cast<sockaddr*>(&address);
    if (bind(listener_, name, size) != 0 || listen(listener_, 1) != 0 ||
        getsockname(listener_, name, &size) != 0)
        throw std::runtime_error("the proxy cannot listen");
    port_ = ntohs(address.sin_port);
    thread_ = std::thread([this] { serve(); });
}

ChaosProxy::~ChaosProxy() {
    thread_.join();
    close(listener_);
}

void ChaosProxy::serve() {
    const int client = accept4(listener_, nullptr, nullptr, SOCK_CLOEXEC);
    const int daemon = tcp_socket();
    const int one = 1;
    setsockopt(client, IPPROTO_TCP, TCP_NODELAY, &one, sizeof one);
    const sockaddr_in address = loopback(daemon_port_);
    Lane up{client, daemon};
    Lane down{daemon, client};
    if (connect(daemon, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0) {
        bool going = true;
        while (going && (up.open || down.open)) {
            std::array<pollfd, 2> waits = {pollfd{up.open ? client : -1, POLLIN, 0},
                                           pollfd{down.open ? daemon : -1, POLLIN, 0}};
            const milliseconds silence_max = patience();
            if (poll(waits.data(), waits.size(), static_cast<int>(silence_max.count())) <= 0) break;
            if (waits[0].revents != 0) going = forward(up, down);
            if (going && waits[1].revents != 0) going = forward(down, up);
        }
    }
    close(client);
    close(daemon);
}

bool ChaosProxy::forward(Lane& lane, Lane& other) {
    std::array<std::byte, 16384> bytes;
    const ssize_t got = recv(lane.from, bytes.data(), bytes.size(), 0);
    if (got <= 0) {
        // An end of one direction is passed on; a broken connection ends both.
        lane.open = false;
        shutdown(lane.to, SHUT_WR);
        return got == 0;
    }
    std::span<const std::byte> rest(bytes.data(), static_cast<std::size_t>(got));
    while (!rest.empty()) {
        std::size_t count = until_point(lane, rest.data(), rest.size());
        const bool strikes = count < rest.size();
        for (; drip_ > 0 && count > 0 && !strikes; --drip_, --count) {
            if (!send_all(lane.to, rest.first(1))) return false;
            rest = rest.subspan(1);
        }
        if (!send_all(lane.to, rest.first(count))) return false;
        rest = rest.subspan(count);
        if (strikes && !do_harm(lane, other)) return false;
        if (!lane.open) return true;
    }
    return true;
}

std::uint64_t ChaosProxy::length(const Lane& lane, Part part) {
    if (part == Part::header) return protocol::header_bytes;
    return part == Part::control ? lane.header.control_bytes : lane.header.bulk_bytes;
}

std::size_t ChaosProxy::until_point(Lane& lane, const std::byte* bytes, std::size_t count) {
    for (std::size_t i = 0; i < count; ++i) {
        // The type is in bytes 4 and 5, so a point in a header lies behind them.
        const bool known = lane.part != Part::header || lane.at >= 8;
        const bool here = known && lane.part == point_.part &&
                          lane.header.type == static_cast<std::uint16_t>(point_.message);
        const std::uint64_t first = lane.part == Part::header ? 8 : 0;
        const std::uint64_t size = length(lane, lane.part);
        if (here && !struck_ && lane.at == first + byte_ % (size - first)) {
            struck_ = true;
            return i;
        }
        if (lane.part == Part::header) {
            lane.header_bytes[lane.at] = bytes[i];
            if (lane.at == 7) std::memcpy(&lane.header.type, lane.header_bytes + 4, 2);
        }
        if (++lane.at < size) continue;
        // Go on to the next part that is not empty; a header follows the last one.
        if (lane.part == Part::header)
            lane.header = protocol::read_header(lane.header_bytes, protocol::Limits{}).value();
        lane.at = 0;
        if (lane.part == Part::header && lane.header.control_bytes != 0)
            lane.part = Part::control;
        else if (lane.part != Part::bulk && lane.header.bulk_bytes != 0)
            lane.part = Part::bulk;
        else
            lane.part = Part::header;
    }
    return count;
}

bool ChaosProxy::do_harm(Lane& lane, Lane& other) {
    const milliseconds pause(1 + random_() % delay_ms_max);
    switch (harm_) {
        case Harm::delay:
            std::this_thread::sleep_for(pause);
            return true;
        case Harm::drip:
            drip_ = 1 + random_() % drip_bytes_max;
            return true;
        case Harm::stall:
            // Stay silent for longer than the peers wait.
            std::this_thread::sleep_for(pause);
            return false;
        case Harm::cut:
            return false;
        case Harm::half_close:
            lane.open = false;
            shutdown(lane.to, SHUT_WR);
            return true;
        case Harm::reset:
            arm_reset(lane.from);
            arm_reset(other.from);
            return false;
    }
    return false;
}

}  // namespace raynest::test
