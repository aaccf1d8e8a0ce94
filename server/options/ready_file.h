// The ready file, which appears once requests are served, and the lock that keeps a second daemon
// out of a state directory.
#pragma once

#include "engine/result.h"
#include "engine/system/child_process.h"

#include <filesystem>
#include <span>
#include <string>

namespace raynest::server {

/// Checks that a ready file may be written: nothing is at `path`, or an empty file, or an older
/// ready file. Otherwise fails with io_failed.
Result<void> check_ready_file(const std::filesystem::path& path);

/// Writes {"listen":[...],"http":"...","pid":N} to a file beside `path`, then renames it, so that a
/// reader sees the whole file or none; `http` is http://HOST:PORT, https://HOST:PORT or "off".
/// Fails as check_ready_file() does.
Result<void> write_ready_file(const std::filesystem::path& path,
                              std::span<const std::string> listen, const std::string& http);

/// Removes the file if it is this process's ready file.
void remove_ready_file(const std::filesystem::path& path);

/// An exclusive lock on DIR/lock; the destructor releases it. Move-only.
class StateLock {
public:
    /// Takes the lock; creates the directory (mode 0700) if needed. Fails with io_failed if another
    /// daemon holds the lock.
    static Result<StateLock> take(const std::filesystem::path& directory);
    /// As take(), for who only reads: creates no folder. Where nothing can be written, it takes the
    /// lock of the file that is there; without one, or where the file system has no such locks, it
    /// returns no lock (descriptor() is -1).
    static Result<StateLock> take_to_read(const std::filesystem::path& directory);
    /// Shares the lock of a daemon that hands it on: both hold it until both have let go.
    static StateLock adopt(Fd descriptor);
    /// The locked file; -1: none.
    [[nodiscard]] int descriptor() const { return descriptor_.get(); }
    StateLock() = default;

private:
    Fd descriptor_;
};

}  // namespace raynest::server
