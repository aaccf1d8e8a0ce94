// Where -o writes: a file, a link's end, a pipe, a device, or stdout.
//
// A new file takes the place of an old one when all of its bytes are there, and keeps its mode. A
// file is written in place where that would change more than its bytes: its folder cannot be
// written, it belongs to somebody else, or it has further names. Devices and pipes are written in
// place, and so is the end of a link, which stays a link.
#pragma once

#include "client/failure.h"

#include <cstddef>
#include <ostream>
#include <span>
#include <string>

namespace raynest::client {

/// True for "-" and for "-.exr": the ending says what is written to stdout.
[[nodiscard]] bool is_stdout(const std::string& path);

/// Where a command says what it has written: stdout, unless that has the bytes themselves.
[[nodiscard]] std::ostream& summary_of(const std::string& path);

/// Refuses a path that write_file() could not write. Called before work of minutes, whose result
/// would be lost.
Result<void> check_writable(const std::string& path);

/// Writes a whole file. On failure no part of a new file is left behind.
Result<void> write_file(const std::string& path, std::span<const std::byte> bytes);

}  // namespace raynest::client
