// Instances by the texts of their paths.
#pragma once

#include "engine/result.h"
#include "engine/scene/edits/instance_place.h"
#include "engine/scene/snapshot.h"

#include <cstdint>
#include <functional>
#include <string_view>
#include <vector>

namespace raynest {

/// Placements that a search for nested instances looks at, at most.
inline constexpr std::uint64_t nested_placements_max = 1 << 20;

/// Returns the instances, in order, all of whose placements have this text, or have it above them,
/// and which lie in no such instance themselves. '*' stands for any text, '/' included, as in mask
/// rules (assets/mask_rules.h). Fails with field_invalid where there is none, and with
/// limit_exceeded beyond nested_placements_max. Looks at all outermost instances, about 1 us each,
/// and at the placements of those that may match in part; ends early, with an error, once `stopped`
/// is true. Thread-safe.
Result<std::vector<InstancePlace>> find_instances(const Snapshot& scene, std::string_view glob,
                                                  const std::function<bool()>& stopped);

/// True if the text, or what stands before one of its '/', is of the form of the glob.
[[nodiscard]] bool glob_matches(std::string_view glob, std::string_view text);

}  // namespace raynest
