// Threads and times of the daemon that no option sets.
#pragma once

#include <chrono>

namespace raynest::server {

/// Maximum spare threads, for tasks that wait while long ones occupy all threads. Three requests
/// have at most 3 * (threads + 1) chunks in flight; that leaves 13 threads for other tasks.
inline constexpr unsigned spare_threads(unsigned threads) {
    return 2 * threads + 16;
}
/// Maximum concurrent imports, and those of one principal; each is a process with limits of its
/// own, which uses all cores. Their memory counts towards --memory.
inline constexpr unsigned imports_max = 8;
inline constexpr unsigned principal_imports_max = 2;
/// Threads that read stored scenes and commit changes of the state folder, and those of one
/// principal: who wakes many scenes leaves one for the edits of others.
inline constexpr unsigned disk_threads = 4;
inline constexpr unsigned principal_disk_threads = 3;
inline constexpr std::chrono::milliseconds drain_look{20};
/// Time for loads and edits to end before a successor takes the state folder over; later ones are
/// told to ask the successor.
inline constexpr std::chrono::seconds settle_time{10};
/// Time for a successor that has the state folder to accept connections; then it is ended.
inline constexpr std::chrono::seconds serve_time{60};
/// Interval of the search for connections whose client's machine or network is gone.
inline constexpr std::chrono::seconds lost_look{5};
/// Interval of looking for credentials that have ended: within a second nobody uses them.
inline constexpr std::chrono::milliseconds credentials_look{300};
/// Time for clients to receive the error after a drain took too long.
inline constexpr std::chrono::milliseconds last_words_time{1000};
inline constexpr int exit_forced = 3;

}  // namespace raynest::server
