#include "tests/bench/race.h"

#include "tests/bench/clock.h"

#include <sched.h>
#include <time.h>
#include <xmmintrin.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <numeric>
#include <thread>

namespace raynest::bench {
namespace {

constexpr std::uint32_t chunk_rays = 4096;

/// On a cache line of its own: neighbours written by two threads cost a whole measurement.
struct alignas(64) Seconds {
    double value = 0;
};

void flush_denormals() {
    _mm_setcsr(_mm_getcsr() | 0x8040U);  // FTZ and DAZ
}

/// The calling thread stays on the n-th CPU that the process may use, counted round.
void pin(unsigned n) {
    cpu_set_t allowed;
    if (sched_getaffinity(0, sizeof allowed, &allowed) != 0) return;
    n %= static_cast<unsigned>(CPU_COUNT(&allowed));
    for (unsigned cpu = 0; cpu < CPU_SETSIZE; ++cpu) {
        if (!CPU_ISSET(cpu, &allowed) || n-- != 0) continue;
        cpu_set_t one;
        CPU_ZERO(&one);
        CPU_SET(cpu, &one);
        sched_setaffinity(0, sizeof one, &one);
        return;
    }
}

}  // namespace

Lap run_lap(const Entrant& entrant, std::uint32_t ray_count) {
    std::vector<Seconds> seconds(entrant.threads);
    std::atomic<std::uint32_t> next{0};
    const auto start = std::chrono::steady_clock::now();
    {
        std::vector<std::jthread> pool;
        for (unsigned thread = 0; thread < entrant.threads; ++thread) {
            pool.emplace_back([&, thread] {
                pin(thread);
                flush_denormals();
                const double begin = seconds_of(CLOCK_THREAD_CPUTIME_ID);
                for (;;) {
                    const std::uint32_t first = next.fetch_add(chunk_rays);
                    if (first >= ray_count) break;
                    entrant.trace(first, std::min(chunk_rays, ray_count - first));
                }
                seconds[thread].value = seconds_of(CLOCK_THREAD_CPUTIME_ID) - begin;
            });
        }
    }
    const std::chrono::duration<double> wall = std::chrono::steady_clock::now() - start;
    const double cpu =
        std::accumulate(seconds.begin(), seconds.end(), 0.0,
                        [](double sum, const Seconds& part) { return sum + part.value; });
    return {cpu, wall.count()};
}

std::vector<std::vector<Lap>> race(std::span<const Entrant> entrants, std::uint32_t ray_count,
                                   int rounds) {
    std::vector<std::vector<Lap>> laps(entrants.size());
    for (int round = 0; round < rounds; ++round) {
        for (std::size_t i = 0; i < entrants.size(); ++i) {
            const std::size_t turn = (i + static_cast<std::size_t>(round)) % entrants.size();
            laps[turn].push_back(run_lap(entrants[turn], ray_count));
        }
    }
    return laps;
}

double median(std::vector<double> values) {
    std::sort(values.begin(), values.end());
    const std::size_t half = values.size() / 2;
    return values.size() % 2 != 0 ? values[half] : 0.5 * (values[half - 1] + values[half]);
}

}  // namespace raynest::bench
