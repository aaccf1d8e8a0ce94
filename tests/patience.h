// How long tests wait for what must come: a hang is a failed test, never a stuck one. Nothing else
// may depend on it; a machine that is slower than that sets RAYNEST_PATIENCE, in seconds.
#pragma once

#include "tests/sanitized.h"

#include <chrono>
#include <cstdlib>
#include <thread>

namespace raynest::test {

inline std::chrono::seconds patience() {
    const char* const told = std::getenv("RAYNEST_PATIENCE");
    return std::chrono::seconds(told != nullptr ? std::atoi(told) : sanitized ? 180 : 30);
}

/// Does it become true before patience ends? Asks again and again.
template <class Condition>
bool eventually(Condition condition) {
    const auto end = std::chrono::steady_clock::now() + patience();
    while (!condition()) {
        if (std::chrono::steady_clock::now() > end) return false;
        std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    return true;
}

}  // namespace raynest::test
