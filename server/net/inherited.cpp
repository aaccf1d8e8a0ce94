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
        if (auto address = address_of(descriptor)) sockets_.push_back({std::move(*address), ""});
    }
}

void InheritedSockets::add(std::vector<HandedSocket> sockets) {
    for (HandedSocket& socket : sockets) {
        // Open until the end, as the service manager's.
        auto address = address_of(fcntl(socket.descriptor.get(), F_DUPFD_CLOEXEC, 0));
        if (!address) continue;
        if (auto* local = std::get_if<UnixAddress>(&*address)) local->has_file = socket.has_file;
        sockets_.push_back({std::move(*address), std::move(socket.value)});
    }
}

void InheritedSockets::claim(Address& address, const std::string& value) {
    const auto same = std::ranges::find_if(sockets_, [&](const Row& socket) {
        return is_same_place(socket.address, address) ||
               (socket.value == value && socket.address.index() == address.index());
    });
    if (same == sockets_.end()) return;
    const Address& found = same->address;
    if (auto* wanted = std::get_if<TcpAddress>(&address)) {
        wanted->descriptor = std::get<TcpAddress>(found).descriptor;
        wanted->port = std::get<TcpAddress>(found).port;
    } else {
        std::get<UnixAddress>(address) = std::get<UnixAddress>(found);
    }
    sockets_.erase(same);
}

void InheritedSockets::warn_of_unclaimed() const {
    for (const Row& socket : sockets_)
        log(LogLevel::warn, "socket_unused",
            {{"uri", to_uri(socket.address)},
             {"reason", std::string(socket.value.empty()
                                        ? "the service manager passes it, and no option names it"
                                        : "the daemon before has handed it on, and no option names "
                                          "it; it is closed with that daemon")}});
}

void InheritedSockets::drop_unclaimed() {
    std::erase_if(sockets_, [](const Row& socket) {
        if (socket.value.empty()) return false;
        if (const auto* local = std::get_if<UnixAddress>(&socket.address)) {
            if (local->has_file) (void)::unlink(local->path.c_str());
            (void)::close(local->descriptor);
        } else {
            (void)::close(std::get<TcpAddress>(socket.address).descriptor);
        }
        return true;
    });
}

}  // namespace raynest::server
