// Decodes a picture of the surroundings where a hostile file cannot hurt: in the import child.
#pragma once

#include "engine/assets/image.h"
#include "engine/assets/import.h"

#include <functional>
#include <span>
#include <string>

namespace raynest {

/// Runs decode_environment() in a child process, as import_in_child() runs an import. The limits are
/// image_side_max, image_bytes_max, bytes_max and time_max.
Result<LightPicture> decode_environment_in_child(
    std::span<const std::byte> file, const ImportLimits& limits, std::span<const std::string> child,
    const std::function<bool()>& wanted = [] { return true; });

}  // namespace raynest
