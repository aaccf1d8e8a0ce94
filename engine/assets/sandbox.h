// Takes rights away from the import process: a parser that an attacker controls opens no socket,
// starts no program, and reads no file but the libraries it is made of.
#pragma once

namespace raynest {

/// Confines this process and its threads for the rest of its life. Where the kernel offers only a
/// part of it, the rest is left out: the process still has its limits.
void enter_sandbox();

}  // namespace raynest
