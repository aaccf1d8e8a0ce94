// File descriptors are what a process runs short of first. The last ones are kept: some for an
// administrator on the Unix socket and for /healthz, the rest for imports and files.
//
//   0 ─── connections of everybody ───┬─ reserved ─┬─ the daemon's own ─┤ LimitNOFILE
#pragma once

#include <string>

namespace raynest::server {

/// The descriptors that were left when a connection was accepted.
enum class Descriptors {
    free,      ///< enough
    reserved,  ///< those of administrators and /healthz
    used_up,
};

/// Connections that the reserved descriptors are for: of the daemon's own user and root on the Unix
/// socket, and as many HTTP ones.
inline constexpr unsigned reserved_places = 4;

/// Tells what was left when this descriptor was opened. A system call opens the lowest free number,
/// so all numbers below it were in use.
[[nodiscard]] Descriptors left_at(int descriptor);

/// Returns "file descriptors are used up: …" with the limit and the remedy.
[[nodiscard]] std::string descriptors_text();
/// Returns that text while new connections are refused for their lack; else empty.
[[nodiscard]] std::string descriptors_fault();

}  // namespace raynest::server
