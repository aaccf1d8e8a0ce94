#include "server/net/inherited.h"

#include "server/ground/log.h"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <charconv>
#include <cstdlib>
#include <string_view>
#include <utility>
#include <variant>

namespace raynest::server {
namespace {

constexpr int first_descriptor = 3;
constexpr int sockets_max = 64;

int number_of(const char* variable) {
    const char* text = std::getenv(variable);  // NOLINT(concurrency-mt-unsafe): nobody sets it
    const std::string_view digits = text == nullptr ? "" : text;
    int number = 0;
    const auto [end, error] = std::from_chars(digits.data(), digits.data() + digits.size(), number);
    return error == std::errc{} && end == digits.data() + digits.size() ? number : 0;
}

/// True if both name the same host and port, or path; TLS or not is the option's choice.
bool is_same_place(const Address& a, const Address& b) {
    if (a.index() != b.index()) return false;
    if (const auto* tcp = std::get_if<TcpAddress>(&a)) {
        const auto& other = std::get<TcpAddress>(b);
        return tcp->host == other.host && tcp->port == other.port;
    }
    return std::get<UnixAddress>(a).path == std::get<UnixAddress>(b).path;
}

}  // namespace

InheritedSockets::InheritedSockets() {
    if (number_of("LISTEN_PID") != getpid()) return;
    const int count = std::min(number_of("LISTEN_FDS"), sockets_max);
    for (int descriptor = first_descriptor; descriptor < first_descriptor + count; ++descriptor) {
        (void)fcntl(descriptor, F_SETFD, FD_CLOEXEC);
        if (auto address = address_of(descriptor)) sockets_.push_back(std::move(*address));
    }
}

void InheritedSockets::claim(Address& address) {
    const auto same = std::ranges::find_if(
        sockets_, [&](const Address& socket) { return is_same_place(socket, address); });
    if (same == sockets_.end()) return;
    const int descriptor = std::visit([](const auto& socket) { return socket.descriptor; }, *same);
    std::visit([&](auto& wanted) { wanted.descriptor = descriptor; }, address);
    sockets_.erase(same);
}

void InheritedSockets::warn_of_unclaimed() const {
    for (const Address& socket : sockets_)
        log(LogLevel::warn, "socket_unused",
            {{"uri", to_uri(socket)},
             {"reason", "the service manager passes it, and no option names it"}});
}

}  // namespace raynest::server
