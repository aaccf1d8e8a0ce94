// A copy of a state folder, made while a daemon uses it.
#pragma once

#include "engine/result.h"

#include <cstdint>
#include <filesystem>

namespace raynest::server {

/// Makes `to`, a state folder with the rows and kept edits that `from` has at one moment, and their
/// blobs. What is copied is on the disk when this returns, under its name; nothing is there if it
/// fails. Returns the number of scenes whose blob is gone from `from`. Fails with io_failed.
/// Blocks.
[[nodiscard]] Result<std::uint64_t> back_up(const std::filesystem::path& from,
                                            const std::filesystem::path& to);

}  // namespace raynest::server
