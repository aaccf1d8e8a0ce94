// Decodes pictures that clients send where a hostile file cannot hurt: in the import child.
//
// Both functions start a process, as import_in_child() does; bytes_max and time_max of `limits`
// hold for it. The answer is checked as if an attacker had written it.
#pragma once

#include "engine/assets/images/image.h"
#include "engine/assets/input/import_request.h"
#include "engine/assets/sandbox/import_child.h"

#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace raynest {

/// Runs decode_environment(), within image_side_max and image_bytes_max.
Result<LightPicture> decode_environment_in_child(
    std::span<const std::byte> file, const ImportLimits& limits, std::span<const std::string> child,
    const StillWanted& wanted = [](std::uint64_t) { return true; });

/// Runs decode_exr(). The file must have exactly this size and these channels; that is checked
/// before a process is started. Returns a plane for each of `channels`, in their order.
Result<std::vector<std::vector<std::uint32_t>>> decode_exr_in_child(
    std::span<const std::byte> file, std::uint32_t width, std::uint32_t height,
    std::span<const ChannelType> channels, const ImportLimits& limits,
    std::span<const std::string> child,
    const StillWanted& wanted = [](std::uint64_t) { return true; });

}  // namespace raynest
