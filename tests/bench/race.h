// Timing several sides against each other: round-robin in one process, so that what the machine
// does meanwhile hits all of them alike.
#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <vector>

namespace raynest::bench {

/// Traces rays [first, first + count); called from several threads at once when threads > 1.
using TracePart = std::function<void(std::uint32_t first, std::uint32_t count)>;

struct Entrant {
    TracePart trace;
    unsigned threads = 1;
};

struct Lap {
    double cpu_seconds;  ///< sum over the entrant's threads, by their own clocks
    double wall_seconds;
};

/// One pass over all rays, in chunks, on threads that are pinned and flush denormals.
Lap run_lap(const Entrant& entrant, std::uint32_t ray_count);

/// Laps [entrant][round]. Each round starts with another entrant.
std::vector<std::vector<Lap>> race(std::span<const Entrant> entrants, std::uint32_t ray_count,
                                   int rounds);

double median(std::vector<double> values);

}  // namespace raynest::bench
