// Looks at the bytes of a scene file before tinygltf does.
//
// tinygltf 2.7 crashes inside Load on some inputs (deep nesting, lying lengths) and takes 1 kB per
// node, so whatever can be refused from the bytes alone is refused here. The guards, in
// this order: container, size, nesting, then names.
#pragma once

#include "engine/assets/import.h"
#include "engine/result.h"

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>

namespace raynest::gltf {

[[nodiscard]] bool starts_as_glb(std::span<const std::byte> file);

/// The JSON chunk of a GLB. Walks the 12-byte header and every chunk header: magic, version 2,
/// total length equal to the bytes received, chunk lengths inside it, JSON first. scene_invalid
/// otherwise.
Result<std::span<const std::byte>> open_glb(std::span<const std::byte> file);

/// One pass over the JSON text that builds nothing: syntax, nesting depth, repeated keys, number of
/// objects, buffers without a home, and the names of files. scene_invalid or limit_exceeded.
Result<void> prescan_json(std::span<const std::byte> json, bool is_glb, const ImportLimits& limits);

}  // namespace raynest::gltf
