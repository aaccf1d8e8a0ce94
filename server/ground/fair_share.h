// The rule by which principals share what the daemon has: memory, requests, connections, imports.
//
// A principal may hold at most `share_factor` times what it leaves free: alone 4/5 of a thing, and
// the next one 4/5 of what is left. So a principal that takes all it can is refused itself and
// never shuts out another. As requests end and others begin, N principals come to 4/(4N + 1) each.
// Switches share the memory for their queues in this way (Choudhury and Hahne, Dynamic Queue Length
// Thresholds for Shared-Memory Packet Switches, 1998): it needs no list of principals and keeps no
// share idle.
#pragma once

#include <cstdint>

namespace raynest::server {

inline constexpr std::uint64_t share_factor = 4;

/// Returns how much more a principal may take of what is free, if it holds `held` of it.
[[nodiscard]] constexpr std::uint64_t fair_part(std::uint64_t held, std::uint64_t free) {
    const std::uint64_t most = share_factor * free;
    return most <= held ? 0 : (most - held) / (share_factor + 1);
}

/// True if a principal that holds `held` places may take one of those that are free. The last one
/// is for a principal that has none.
[[nodiscard]] constexpr bool fair_place(std::uint64_t held, std::uint64_t free) {
    return free != 0 && (held == 0 || fair_part(held, free) != 0);
}

}  // namespace raynest::server
