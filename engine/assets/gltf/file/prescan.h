// Checks the bytes of a scene file before tinygltf reads them.
//
// tinygltf 2.7 crashes inside Load on some inputs (deep nesting, false lengths) and takes 1 kB per
// node. So everything that can be refused from the bytes alone is refused here, in this order:
// container, size, nesting, names.
#pragma once

#include "engine/assets/input/import_request.h"
#include "engine/result.h"

#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

namespace raynest::gltf {

[[nodiscard]] bool starts_as_glb(std::span<const std::byte> file);

/// The two chunks of a GLB that glTF defines.
struct Glb {
    std::span<const std::byte> json;
    std::span<const std::byte> binary;  ///< empty if absent
};

/// Walks the 12-byte header and every chunk header: magic, version 2, total length inside the bytes
/// received, chunk lengths inside it, JSON first; otherwise scene_invalid. Accepts bytes after the
/// total length, and chunks that are not aligned to 4 bytes.
Result<Glb> open_glb(std::span<const std::byte> file);

/// Facts about a JSON text that decide how it is read.
struct Prescan {
    /// True if the only buffer is the first one without a URI, and no picture has a URI: then a
    /// GLB's BIN chunk is the only data.
    bool one_binary = true;
    /// extras.raynest.mask of nodes, which tinygltf would cut to an int; nothing for an invalid
    /// one.
    std::map<std::uint32_t, std::optional<std::uint32_t>> masks;
    /// Members of a wrong type, which tinygltf passes over in silence: the first of each kind.
    struct Mistyped {
        std::string_view list;  ///< "nodes"
        std::uint32_t element;
        std::string_view member;
        std::string_view wanted;  ///< "a number"
        std::uint64_t more;       ///< elements with the same fault
    };
    std::vector<Mistyped> mistyped;
};

/// Checks syntax, nesting depth, repeated keys, the number of objects, and file names in one pass
/// that builds nothing. scene_invalid or limit_exceeded.
Result<Prescan> prescan_json(std::span<const std::byte> json, const ImportLimits& limits);

}  // namespace raynest::gltf
