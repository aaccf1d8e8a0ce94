// The destination of -o: a file, the target of a link, a pipe, a device, or stdout.
//
// A complete new file replaces an old one and keeps its mode. A file is written in place if
// replacing it would change more than its bytes: if its folder cannot be written, if it belongs to
// another user, or if it has further names. Devices, pipes and targets of links are written in
// place; a link stays a link.
#pragma once

#include "client/ground/failure.h"

#include <cstddef>
#include <ostream>
#include <span>
#include <string>

namespace raynest::client {

/// True for "-" and for "-.exr", whose ending is the format.
[[nodiscard]] bool is_stdout(const std::string& path);

/// Returns the stream for a command's summary: stdout, or stderr if stdout has the bytes.
[[nodiscard]] std::ostream& summary_of(const std::string& path);

/// Fails for a path that write_file() could not write. Called before long work, whose result would
/// otherwise be lost.
Result<void> check_writable(const std::string& path);

/// Writes a whole file. After a failure no part of a new file remains.
Result<void> write_file(const std::string& path, std::span<const std::byte> bytes);

}  // namespace raynest::client
