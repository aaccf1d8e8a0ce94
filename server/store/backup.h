// A copy of a state folder, made while a daemon uses it.
#pragma once

#include "engine/result.h"

#include <cstdint>
#include <filesystem>

namespace raynest::server {

struct BackupCounts {
    std::uint64_t scenes = 0;
    std::uint64_t bytes = 0;    ///< of their blobs
    std::uint64_t missing = 0;  ///< scenes whose blob is gone from `from`
};

/// Makes `to`, a state folder with the rows and kept edits that `from` has at one moment, and their
/// blobs. What is copied is on the disk when this returns, under its name; nothing is there if it
/// fails. Fails with io_failed. Blocks.
[[nodiscard]] Result<BackupCounts> back_up(const std::filesystem::path& from,
                                           const std::filesystem::path& to);

}  // namespace raynest::server
