// CPU time and scenes for the rows of this bench.
#pragma once

#include "engine/scene/snapshot.h"
#include "tests/bench/clock.h"

#include <algorithm>
#include <limits>
#include <memory>
#include <stdexcept>
#include <utility>

namespace raynest::bench {

inline double cpu() {
    return seconds_of(CLOCK_PROCESS_CPUTIME_ID);
}

/// Returns the least CPU seconds that work(round) took.
template <class Work>
double best_of(int rounds, Work&& work) {
    double best = std::numeric_limits<double>::infinity();
    for (int i = 0; i < rounds; ++i) {
        const double begin = cpu();
        work(i);
        best = std::min(best, cpu() - begin);
    }
    return best;
}

inline std::shared_ptr<const Snapshot> built(const SceneDescription& description) {
    auto scene = Snapshot::build(description);
    if (!scene) throw std::runtime_error(scene.error().message);
    return std::move(*scene);
}

}  // namespace raynest::bench
