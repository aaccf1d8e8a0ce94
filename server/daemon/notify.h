// Tells the service manager how the daemon is, as systemd's sd_notify() does: a datagram to the
// socket that the environment names. Without a service manager nothing happens.
#pragma once

#include <chrono>
#include <optional>
#include <string_view>

namespace raynest::server {

/// Sends a state, such as "READY=1", "STOPPING=1" or "WATCHDOG=1".
void notify(std::string_view state);

/// Returns how often the service manager wants "WATCHDOG=1": half of the time after which it takes
/// the daemon for stuck. Nothing if it does not watch this process.
[[nodiscard]] std::optional<std::chrono::microseconds> watchdog_interval();

}  // namespace raynest::server
