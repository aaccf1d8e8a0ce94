// Building instead of tracing: seconds and bytes of our trees against the peer's.
#pragma once

#include "engine/result.h"
#include "tests/bench/contest.h"
#include "tests/bench/options.h"

namespace raynest::bench {

/// A row of kind "memory"; for scenes without instances also rows of kind "build", one per stage of
/// ours, quality of --quality and thread count. Stages: `tree` is boxes, tree and filled leaves,
/// what the peer's commit does; `scene` is the whole way from a description to a checked snapshot,
/// with copies of all attributes and their hash. Always true: builds have no answers that could
/// differ.
Result<bool> race_builds(const Options& options, Loaded& loaded);

}  // namespace raynest::bench
