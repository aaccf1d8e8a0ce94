// root:PATH: files under --scene-root, and nothing else.
//
// The kernel resolves the path with RESOLVE_BENEATH and RESOLVE_NO_SYMLINKS, so that no "..", link
// or race leaves the folder; FIFOs and devices are refused after a non-blocking open.
#pragma once

#include "engine/result.h"
#include "server/store/budget.h"

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
    Budget::Lease lease;  ///< of the bytes
};

/// The regular file `path` under `root`, at most `bytes_max` long, reserved from the budget before
/// it is read: out_of_memory where that has too little left. Blocking. The messages name the path
/// as asked for, never the folder.
Result<SourceFile> read_under_root(const std::filesystem::path& root, std::string_view path,
                                   std::uint64_t bytes_max, Budget& budget);

}  // namespace raynest::server
