#include "tests/bench/crowding.h"

#include "tests/bench/clock.h"

#include <algorithm>
#include <array>
#include <cstdint>

namespace raynest::bench {
namespace {

constexpr int independent_turns = 4000;
constexpr int dependent_turns = 400;

/// So that the compiler leaves each instruction as it stands.
void keep(std::uint64_t& value) {
    asm volatile("" : "+r"(value));
}

double seconds_of_independent() {
    std::array<std::uint64_t, 6> values = {1, 2, 3, 4, 5, 6};
    const double start = seconds_of(CLOCK_THREAD_CPUTIME_ID);
    for (int turn = 0; turn < independent_turns; ++turn) {
        for (std::uint64_t& value : values) keep(value += 3);
        for (std::uint64_t& value : values) keep(value ^= 5);
    }
    return seconds_of(CLOCK_THREAD_CPUTIME_ID) - start;
}

double seconds_of_dependent() {
    std::uint64_t value = 3;
    const double start = seconds_of(CLOCK_THREAD_CPUTIME_ID);
    for (int turn = 0; turn < dependent_turns; ++turn) {
        for (int i = 0; i < 8; ++i) {
            value *= value;
            keep(value);
        }
    }
    return seconds_of(CLOCK_THREAD_CPUTIME_ID) - start;
}

}  // namespace

double crowding() {
    // An interruption of it would pass for a core that is more than ours.
    const double dependent = std::min(seconds_of_dependent(), seconds_of_dependent());
    return seconds_of_independent() / independent_turns / (dependent / dependent_turns);
}

}  // namespace raynest::bench
