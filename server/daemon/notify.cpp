#include "server/daemon/notify.h"

#include "engine/system/child_process.h"

#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <charconv>
#include <cstdint>
#include <cstdlib>
#include <string>

namespace raynest::server {
namespace {

std::string variable(const char* name) {
    const char* value = std::getenv(name);  // NOLINT(concurrency-mt-unsafe): nobody sets it
    return value == nullptr ? "" : value;
}

std::optional<std::uint64_t> to_number(const std::string& text) {
    std::uint64_t number = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
    if (text.empty() || error != std::errc{} || end != text.data() + text.size())
        return std::nullopt;
    return number;
}

}  // namespace

void notify(std::string_view state) {
    const std::string path = variable("NOTIFY_SOCKET");
    sockaddr_un name{};
    if (path.empty() || path.size() >= sizeof name.sun_path) return;
    name.sun_family = AF_UNIX;
    std::copy(path.begin(), path.end(), name.sun_path);
    if (path.front() == '@') name.sun_path[0] = '\0';  // a name outside the file system
    const Fd sender(socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0));
    // A lost message is repeated or missed by the service manager, which then says so.
    (void)sendto(sender.get(), state.data(), state.size(), MSG_NOSIGNAL | MSG_DONTWAIT,
                 reinterpret_cast<const sockaddr*>(&name),
                 static_cast<socklen_t>(offsetof(sockaddr_un, sun_path) + path.size()));
}

std::optional<std::chrono::microseconds> watchdog_interval() {
    const auto period = to_number(variable("WATCHDOG_USEC"));
    const auto process = to_number(variable("WATCHDOG_PID"));
    const bool is_ours = !process || *process == static_cast<std::uint64_t>(getpid());
    if (!period || *period < 2 || !is_ours) return std::nullopt;
    return std::chrono::microseconds(*period / 2);
}

}  // namespace raynest::server
