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

/// A chunk of rays.
struct Part {
    double cpu_seconds;
    double crowding;  ///< before it or after it, the larger one (crowding.h)
};

struct Lap {
    double cpu_seconds;  ///< sum over the parts
    double wall_seconds;
    std::vector<Part> parts;
};

/// One pass over all rays, in chunks, on threads that are pinned and flush denormals. They begin
/// once the core is theirs, or after a tenth of a second.
Lap run_lap(const Entrant& entrant, std::uint32_t ray_count, double crowded_from);

struct RaceLaps {
    std::vector<std::vector<Lap>> laps;  ///< [entrant][round]
    double crowded_from;                 ///< a tenth more than where a core was ours, so far
};

/// Each round starts with another entrant. There are up to three times as many rounds where a part
/// of some entrant was crowded in all but two.
RaceLaps race(std::span<const Entrant> entrants, std::uint32_t ray_count, int rounds);

/// Seconds of one entrant: of each part the median over the laps in which it was not crowded; over
/// all laps where it always was.
double uncrowded_seconds(std::span<const Lap> laps, double crowded_from);
/// Laps of parts that were not crowded, of 1.
double uncrowded_share(std::span<const Lap> laps, double crowded_from);

double median(std::vector<double> values);

}  // namespace raynest::bench
