// A copy of a state folder, made while a daemon uses it, and the way back.
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

/// Puts a copy of the state folder `backup` in the place of all that `folder` holds, which is moved
/// to its folder `replaced`; makes `folder` if it is not there. No daemon may use it: the caller has
/// its StateLock. If it fails, `folder` holds what it held. Returns the number of scenes whose blob
/// is gone from `backup`. Fails with io_failed. Blocks.
[[nodiscard]] Result<std::uint64_t> restore(const std::filesystem::path& backup,
                                            const std::filesystem::path& folder);

/// True if a restore of the folder was cut off after its copy was complete.
[[nodiscard]] bool is_half_restored(const std::filesystem::path& folder);
/// Ends a restore that was cut off, if there was one. The caller has the StateLock. Fails with
/// io_failed. Blocks.
[[nodiscard]] Result<void> finish_restore(const std::filesystem::path& folder);

/// Removes what no scene of the state folder needs: blobs without a row, damaged blobs, unfinished
/// files, and what a restore has replaced. The caller has the StateLock. Returns their bytes. Fails
/// with io_failed, and removes nothing if the manifest cannot be read. Blocks.
[[nodiscard]] Result<std::uint64_t> remove_garbage(const std::filesystem::path& folder);

/// Removes damaged blobs, and what a restore has replaced, also while a daemon uses the folder.
/// Returns their bytes. Fails with io_failed. Blocks.
[[nodiscard]] Result<std::uint64_t> remove_set_aside(const std::filesystem::path& folder);

}  // namespace raynest::server
