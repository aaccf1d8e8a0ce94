// Checks what shading reads, in a description as in an arena.
#pragma once

#include "engine/result.h"
#include "engine/shading/records.h"

#include <cstddef>
#include <cstdint>
#include <span>

namespace raynest {

/// True if all numbers are finite and within their ranges, and textures are below `textures`.
[[nodiscard]] bool is_sound(const SurfaceRecord& surface, std::uint64_t textures);
/// True if all numbers are finite and within their ranges, and the direction is a unit vector.
[[nodiscard]] bool is_sound(const LightRecord& light);

/// Checks sections of an arena whose other sections were checked; `view` is theirs.
Result<void> check_shading(std::span<const std::byte> arena, const SceneView& view);

}  // namespace raynest
