// Seconds of one of the machine's clocks.
#pragma once

#include <time.h>

namespace raynest::bench {

/// `clock` as of clock_gettime: CLOCK_MONOTONIC, CLOCK_THREAD_CPUTIME_ID, ...
inline double seconds_of(clockid_t clock) {
    timespec now{};
    clock_gettime(clock, &now);
    return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

}  // namespace raynest::bench
