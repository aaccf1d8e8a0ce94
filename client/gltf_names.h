// Which files does a glTF name? Read from its JSON without building a document.
//
// The daemon's import child validates; the client only needs the names, from files that may be
// hostile. So the JSON is streamed: constant memory, no recursion, a bound on depth and size.
#pragma once

#include "client/failure.h"

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::client {

inline constexpr std::uint64_t json_bytes_max = 64ULL << 20;
inline constexpr std::size_t json_depth_max = 64;

/// The JSON text of a .gltf or .glb; a GLB's header and chunk lengths are checked. Exit code 5.
Result<std::span<const std::byte>> gltf_json(std::span<const std::byte> file);

/// A file that a glTF names.
struct GltfFile {
    std::string name;
    bool is_picture;  ///< named by images alone: the scene can do without it
};
/// The files that buffers and images name, each once, in file order. What names no file beneath the
/// scene's folder is left out: the daemon says so where it matters. Exit code 5 for text that is no
/// JSON object or is nested too deeply.
Result<std::vector<GltfFile>> gltf_names(std::span<const std::byte> json);

/// The file that a URI stands for: percent-decoded once, with / for \, without empty parts and
/// "./", with "a/.." cancelled. Nothing where the URI has a scheme, is absolute, leaves the scene's
/// folder, hides a separator, "." or ".." behind percent signs, or is not printable. The daemon
/// applies the same rule (tests/golden/gltf_uris.json).
std::optional<std::string> file_of_uri(std::string_view uri);

}  // namespace raynest::client
