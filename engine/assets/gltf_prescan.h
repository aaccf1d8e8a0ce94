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

/// The two chunks of a GLB that mean something.
struct Glb {
    std::span<const std::byte> json;
    std::span<const std::byte> binary;  ///< empty where there is none
};

/// Walks the 12-byte header and every chunk header: magic, version 2, total length inside the bytes
/// received, chunk lengths inside it, JSON first. scene_invalid otherwise. Bytes behind the total
/// length, and chunks that are not aligned to 4 bytes, are taken as they are.
Result<Glb> open_glb(std::span<const std::byte> file);

/// The facts of a JSON text that decide who reads it.
struct Prescan {
    /// The only buffer is the first one without a URI, and no picture has a URI: the BIN chunk of a
    /// GLB is all there is to read.
    bool one_binary = true;
};

/// One pass over the JSON text that builds nothing: syntax, nesting depth, repeated keys, number of
/// objects, and the names of files. scene_invalid or limit_exceeded.
Result<Prescan> prescan_json(std::span<const std::byte> json, const ImportLimits& limits);

}  // namespace raynest::gltf
