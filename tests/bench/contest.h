// One set of rays through every side that was asked for: answers are compared first, then raced.
#pragma once

#include "engine/packs/registry.h"
#include "engine/result.h"
#include "tests/bench/options.h"
#include "tests/bench/peer.h"
#include "tests/bench/workload.h"

#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace raynest::bench {

/// The modules and the scene of a run.
struct Loaded {
    std::vector<std::shared_ptr<const Registry>> registries;  ///< one per target of the options
    std::vector<std::unique_ptr<PeerLibrary>> peers;          ///< empty when none was asked for
    Workload workload;
    std::optional<Workload> over;  ///< the other form of the scene
};

/// Prints the rows of one set of rays: every variant of ours against every opponent that answers
/// the same question. False when more answers differ from an opponent's than edges explain. Fails
/// when two variants of ours differ in a bit.
Result<bool> contest(const Options& options, Loaded& loaded, const std::string& rays);

}  // namespace raynest::bench
