#include "tests/bench/race.h"

#include "tests/bench/clock.h"
#include "tests/bench/cpus.h"
#include "tests/bench/crowding.h"

#include <xmmintrin.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <thread>
#include <utility>

namespace raynest::bench {
namespace {

constexpr std::uint32_t chunk_rays = 4096;

void flush_denormals() {
    _mm_setcsr(_mm_getcsr() | 0x8040U);  // FTZ and DAZ
}

/// Neighbours come and go within tenths of a second. Gives the crowding at the end.
double await_own_core(double crowded_from) {
    constexpr double patience = 0.1;
    const double end = seconds_of(CLOCK_MONOTONIC) + patience;
    double now = crowding();
    while (now >= crowded_from && seconds_of(CLOCK_MONOTONIC) < end) now = crowding();
    return now;
}

/// Not the least crowding that was seen: an interruption makes outliers on either side.
double low_of(std::vector<double> crowdings) {
    const auto low = crowdings.begin() + static_cast<std::ptrdiff_t>(crowdings.size() / 50);
    std::nth_element(crowdings.begin(), low, crowdings.end());
    return *low;
}

double crowded_from(const std::vector<std::vector<Lap>>& laps) {
    // The least crowding seen by this process, which stands for an undisturbed core.
    static double least = [] {
        constexpr double seconds = 0.5;
        const double end = seconds_of(CLOCK_MONOTONIC) + seconds;
        std::vector<double> crowdings;
        while (seconds_of(CLOCK_MONOTONIC) < end) crowdings.push_back(crowding());
        return low_of(std::move(crowdings));
    }();
    std::vector<double> crowdings;
    for (const std::vector<Lap>& entrant : laps)
        for (const Lap& lap : entrant)
            for (const Part& part : lap.parts) crowdings.push_back(part.crowding);
    if (!crowdings.empty()) least = std::min(least, low_of(std::move(crowdings)));
    return 1.1 * least;
}

/// Has some part fewer laps that were not crowded than a median needs?
bool too_crowded(const RaceLaps& race, int rounds) {
    const std::ptrdiff_t enough = std::min(3, rounds);
    for (const std::vector<Lap>& laps : race.laps) {
        for (std::size_t part = 0; part < laps.front().parts.size(); ++part) {
            const auto is_uncrowded = [&](const Lap& lap) {
                return lap.parts[part].crowding < race.crowded_from;
            };
            if (std::count_if(laps.begin(), laps.end(), is_uncrowded) < enough) return true;
        }
    }
    return false;
}

}  // namespace

Lap run_lap(const Entrant& entrant, std::uint32_t ray_count, double crowded_from) {
    Lap lap{0, 0, std::vector<Part>((ray_count + chunk_rays - 1) / chunk_rays)};
    std::atomic<std::uint32_t> next{0};
    const auto start = std::chrono::steady_clock::now();
    {
        std::vector<std::jthread> pool;
        for (unsigned thread = 0; thread < entrant.threads; ++thread) {
            pool.emplace_back([&, thread] {
                pin(thread);
                flush_denormals();
                double before = await_own_core(crowded_from);
                for (;;) {
                    const std::uint32_t part = next.fetch_add(1);
                    if (part >= lap.parts.size()) break;
                    const std::uint32_t first = part * chunk_rays;
                    const auto count = std::min(chunk_rays, ray_count - first);
                    // The kernel subtracts time that a hypervisor stole from this clock afterwards;
                    // a part may then have taken no time at all, and is traced again.
                    double seconds = 0;
                    while (seconds <= 0) {
                        const double begin = seconds_of(CLOCK_THREAD_CPUTIME_ID);
                        entrant.trace(first, count);
                        seconds = seconds_of(CLOCK_THREAD_CPUTIME_ID) - begin;
                    }
                    const double after = crowding();
                    lap.parts[part] = {seconds, std::max(before, after)};
                    before = after;
                }
            });
        }
    }
    lap.wall_seconds =
        std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    for (const Part& part : lap.parts) lap.cpu_seconds += part.cpu_seconds;
    return lap;
}

RaceLaps race(std::span<const Entrant> entrants, std::uint32_t ray_count, int rounds) {
    RaceLaps race{std::vector<std::vector<Lap>>(entrants.size()), crowded_from({})};
    for (int round = 0; round < rounds || (round < 3 * rounds && too_crowded(race, rounds));
         ++round) {
        for (std::size_t i = 0; i < entrants.size(); ++i) {
            const std::size_t turn = (i + static_cast<std::size_t>(round)) % entrants.size();
            race.laps[turn].push_back(run_lap(entrants[turn], ray_count, race.crowded_from));
        }
        race.crowded_from = crowded_from(race.laps);
    }
    return race;
}

double uncrowded_seconds(std::span<const Lap> laps, double crowded_from) {
    double sum = 0;
    for (std::size_t part = 0; part < laps.front().parts.size(); ++part) {
        std::vector<double> uncrowded;
        std::vector<double> all;
        for (const Lap& lap : laps) {
            const Part& timed = lap.parts[part];
            all.push_back(timed.cpu_seconds);
            if (timed.crowding < crowded_from) uncrowded.push_back(timed.cpu_seconds);
        }
        sum += median(std::move(uncrowded.empty() ? all : uncrowded));
    }
    return sum;
}

double uncrowded_share(std::span<const Lap> laps, double crowded_from) {
    std::size_t uncrowded = 0;
    std::size_t all = 0;
    for (const Lap& lap : laps) {
        all += lap.parts.size();
        for (const Part& part : lap.parts) uncrowded += part.crowding < crowded_from ? 1 : 0;
    }
    return static_cast<double>(uncrowded) / static_cast<double>(all);
}

double median(std::vector<double> values) {
    std::sort(values.begin(), values.end());
    const std::size_t half = values.size() / 2;
    return values.size() % 2 != 0 ? values[half] : 0.5 * (values[half - 1] + values[half]);
}

}  // namespace raynest::bench
