// Takes rights away from the import process: a parser that an attacker controls opens no socket,
// starts no process, changes no file, signals nobody, and reads no file but the libraries it is
// made of.
//
// Two layers of the kernel do it, and each holds alone: Landlock (files, TCP, signals) and a
// seccomp filter, which is a list of what is allowed. A call that is not on it fails with ENOSYS,
// as on a kernel that lacks it: libraries are made for that, and fall back.
#pragma once

#include <string>

namespace raynest {

/// Returns what this build or this kernel lacks for the sandbox, as one line; empty if nothing.
[[nodiscard]] std::string sandbox_gaps();

/// Confines this process and the threads that it starts, for the rest of its life. Call it before
/// other threads start. Leaves out what sandbox_gaps() names. False if anything else fails: then
/// read nothing hostile.
[[nodiscard]] bool enter_sandbox();

/// The layers of enter_sandbox(), which calls both; for tests.
[[nodiscard]] bool restrict_files();
[[nodiscard]] bool restrict_calls();

}  // namespace raynest
