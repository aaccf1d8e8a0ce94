// Readiness and exclusiveness on disk: the file that says "requests are served", and the lock that
// keeps two daemons out of one state directory.
#pragma once

#include "engine/result.h"

#include <filesystem>
#include <span>
#include <string>

namespace raynest::server {

/// May a ready file be put there? Where nothing is, or an empty file, or an older ready file;
/// io_failed names anything else.
Result<void> check_ready_file(const std::filesystem::path& path);

/// Writes {"listen":[...],"http":"off","pid":N} beside `path`, then renames: a reader sees the
/// whole file or none. Fails as check_ready_file() does.
Result<void> write_ready_file(const std::filesystem::path& path,
                              std::span<const std::string> listen);

/// Removes the ready file of this process, and nothing else.
void remove_ready_file(const std::filesystem::path& path);

/// An exclusive lock on DIR/lock for as long as it lives. Move-only.
class StateLock {
public:
    /// Makes the directory (mode 0700) when it is not there; io_failed when another daemon has it.
    static Result<StateLock> take(const std::filesystem::path& directory);
    StateLock() = default;
    StateLock(StateLock&& other) noexcept : descriptor_(std::exchange(other.descriptor_, -1)) {}
    StateLock& operator=(StateLock&& other) noexcept {
        std::swap(descriptor_, other.descriptor_);
        return *this;
    }
    StateLock(const StateLock&) = delete;
    ~StateLock();

private:
    int descriptor_ = -1;
};

}  // namespace raynest::server
