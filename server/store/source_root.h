// root:PATH: files under --scene-root, and nothing else.
//
// The kernel resolves the path with RESOLVE_BENEATH and RESOLVE_NO_SYMLINKS, so that no "..", link
// or race leaves the folder; FIFOs and devices are refused after a non-blocking open.
#pragma once

#include "engine/result.h"

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::server {

/// A whole file, by the name that the importer will look it up by.
struct SourceFile {
    std::string name;
    std::vector<std::byte> bytes;
};

/// The regular file `path` under `root`, at most `bytes_max` long. Blocking. The messages name the
/// path as asked for, never the folder.
Result<SourceFile> read_under_root(const std::filesystem::path& root, std::string_view path,
                                   std::uint64_t bytes_max);

}  // namespace raynest::server
