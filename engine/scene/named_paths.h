// The paths that a text names.
#pragma once

#include "engine/scene/snapshot.h"

#include <cstdint>
#include <string_view>
#include <vector>

namespace raynest {

/// Paths [first, end).
struct PathRange {
    std::uint64_t first = 0;
    std::uint64_t end = 0;
};

/// Returns the paths that have this text, or have it above them: ranges that ascend and do not
/// touch; none where a step of the text has no name or is not there. The first text of a scene that
/// leads through a long list looks at all of it (StepIndices); in a scene with nodes each looks at those
/// below the last step.
[[nodiscard]] std::vector<PathRange> named_paths(const Snapshot& scene, std::string_view text);

/// The path behind the last one of a run, of a scene with `path_count` paths.
[[nodiscard]] std::uint64_t end_of_run(const PathTable& paths, std::uint32_t run,
                                       std::uint64_t path_count);

}  // namespace raynest
