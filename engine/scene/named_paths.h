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
/// touch; none where a step of the text has no name or is not there. Looks at what lies beside each
/// step, at about 2 ns, and in a scene with nodes at those below the last one.
[[nodiscard]] std::vector<PathRange> named_paths(const Snapshot& scene, std::string_view text);

/// The path behind the last one of a run, of a scene with `path_count` paths.
[[nodiscard]] std::uint64_t end_of_run(const PathTable& paths, std::uint32_t run,
                                       std::uint64_t path_count);

}  // namespace raynest
