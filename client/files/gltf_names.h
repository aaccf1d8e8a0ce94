// Reads the names of a glTF's files from its JSON, without building a document.
//
// The daemon's import child validates scenes; the client needs only names, from files that may be
// hostile. The JSON is streamed: constant memory, no recursion, bounded depth and size.
#pragma once

#include "client/ground/failure.h"

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

/// Returns what a file is that calls itself .glb, if `is_glb`, or .gltf, and is neither: "is a Git
/// LFS pointer ...". "" where it may be one.
std::string why_no_gltf(std::span<const std::byte> file, bool is_glb);

/// Returns the JSON text of a .gltf or .glb. Checks a GLB's header and chunk lengths. Exit code 5.
Result<std::span<const std::byte>> gltf_json(std::span<const std::byte> file);

/// A file that a glTF names.
struct GltfFile {
    std::string name;
    bool is_picture;  ///< named by images alone: the scene can do without it
};
/// Returns the files that buffers and images name, each once, in file order. Names outside the
/// scene's folder are left out: the daemon complains if it needs them. Exit code 5 for text that is
/// no JSON object or is nested too deeply.
Result<std::vector<GltfFile>> gltf_names(std::span<const std::byte> json);

/// Returns the file of a URI: percent-decoded once, with / for \, without empty parts and "./",
/// with "a/.." cancelled. Nothing if the URI has a scheme, is absolute, leaves the scene's folder,
/// hides a separator, "." or ".." behind percent signs, or is not printable. The daemon applies the
/// same rule (tests/golden/gltf_uris.json).
std::optional<std::string> file_of_uri(std::string_view uri);

}  // namespace raynest::client
