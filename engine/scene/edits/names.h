// Outermost instances by the texts of their paths.
#pragma once

#include "engine/result.h"
#include "engine/scene/snapshot.h"

#include <cstdint>
#include <functional>
#include <string_view>
#include <vector>

namespace raynest {

/// Returns the outermost instances, in order, whose path, or a path above it, has this text. '*' stands
/// for any text, '/' included, as in mask rules (assets/mask_rules.h). Fails with field_invalid where
/// there is none; says so if the text names something inside of an instance. Looks at all outermost
/// instances, about 1 us each; ends early, with an error, once `stopped` is true. Thread-safe.
Result<std::vector<std::uint32_t>> find_instances(const Snapshot& scene, std::string_view glob,
                                                  const std::function<bool()>& stopped);

/// True if the text, or what stands before one of its '/', is of the form of the glob.
[[nodiscard]] bool glob_matches(std::string_view glob, std::string_view text);

}  // namespace raynest
