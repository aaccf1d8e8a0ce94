// root:PATH: files under --scene-root, and nothing else.
//
// The kernel resolves each path with RESOLVE_BENEATH, so that no "..", link or race leaves the
// folder; links that end inside it are followed. FIFOs and devices are refused after a non-blocking
// open.
#pragma once

#include "engine/result.h"
#include "server/store/budget.h"

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <optional>
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

/// The regular file `name` beneath `folder`, which lies beneath `root`; nothing where it is absent.
/// At most `bytes_max` long, and reserved from the budget before it is read: out_of_memory where
/// that has too little left. Blocking. The messages name the path as asked for, never the root.
Result<std::optional<SourceFile>> read_under_root(const std::filesystem::path& root,
                                                  const std::filesystem::path& folder,
                                                  const std::string& name, std::uint64_t bytes_max,
                                                  Budget& budget);

}  // namespace raynest::server
