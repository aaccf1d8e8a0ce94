// The memory and the threads of a child process, read while it runs.
#pragma once

#include "engine/system/child_process.h"

#include <sys/types.h>

#include <cstdint>

namespace raynest {

/// Measures what a child holds of the machine's memory: private pages, also swapped ones, shared
/// ones, and a memory file that it writes. Pages of programs and libraries do not count.
class ChildMemory {
public:
    /// Call this before the child confines itself: from then on it hides from its own user where
    /// /proc is mounted with hidepid. `shared_bytes` of its shared pages are counted
    /// elsewhere.
    ChildMemory(pid_t child, const Fd& written, std::uint64_t shared_bytes);

    /// Returns the bytes that the child holds now; those of the memory file alone once it has been
    /// reaped, or if its status cannot be read.
    [[nodiscard]] std::uint64_t bytes() const;
    /// Returns the number of threads of the child; 0 if its status cannot be read: then nothing is
    /// known of its memory.
    [[nodiscard]] std::uint64_t threads() const;

private:
    const Fd status_;
    const Fd& written_;
    const std::uint64_t shared_bytes_;
};

}  // namespace raynest
