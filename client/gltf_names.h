// Which files does a glTF name? Read from its JSON without building a document.
//
// The daemon's import child validates; the client only needs the names, from files that may be
// hostile. So the JSON is streamed: constant memory, no recursion, a bound on depth and size.
#pragma once

#include "client/failure.h"

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace raynest::client {

inline constexpr std::uint64_t json_bytes_max = 64ULL << 20;
inline constexpr std::size_t json_depth_max = 64;

/// The JSON text of a .gltf or .glb; a GLB's header and chunk lengths are checked. Exit code 5.
Result<std::span<const std::byte>> gltf_json(std::span<const std::byte> file);

/// The uris of buffers and images, percent-decoded, without data: uris and repetitions, in file
/// order. Exit code 5 for text that is no JSON object, is nested too deeply, or has a uri that is
/// not a relative path of plain components.
Result<std::vector<std::string>> gltf_names(std::span<const std::byte> json);

/// The file name that a uri stands for. Refuses schemes, absolute names, "..", "%2e", "%2f", NUL,
/// backslashes and what is not printable.
Result<std::string> decode_uri(const std::string& uri);

}  // namespace raynest::client
