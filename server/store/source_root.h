// Reads root:PATH, files under --scene-root.
//
// The operating system resolves each path with RESOLVE_BENEATH, so that no "..", link or race can
// leave the folder; links that end inside it are followed. Where a unit's RestrictSUIDSGID= takes
// that call away, no link is followed. FIFOs and devices are refused after a non-blocking open.
#pragma once

#include "engine/result.h"
#include "server/ground/budget.h"

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace raynest::server {

/// The budget that a load's files are charged to, and its principal.
struct LoadMemory {
    Budget& budget;
    const std::string& principal;
};

/// A whole file, and the name by which the importer finds it.
struct SourceFile {
    std::string name;
    std::vector<std::byte> bytes;
    Budget::Lease lease;  ///< for `bytes`
};

/// Reads the regular file `name` beneath `folder`, which lies beneath `root`; returns nothing if it
/// does not exist. Fails with limit_exceeded beyond `bytes_max`, and with out_of_memory if the
/// principal may take no memory for the file. Blocking. Error messages contain the requested path,
/// never the root.
Result<std::optional<SourceFile>> read_under_root(const std::filesystem::path& root,
                                                  const std::filesystem::path& folder,
                                                  const std::string& name, std::uint64_t bytes_max,
                                                  const LoadMemory& memory);

}  // namespace raynest::server
