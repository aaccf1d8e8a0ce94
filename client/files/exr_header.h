// Reads the attributes of an OpenEXR file that are texts; no pixel is looked at.
#pragma once

#include "client/ground/failure.h"

#include <cstddef>
#include <map>
#include <span>
#include <string>

namespace raynest::client {

/// Returns the attributes of type string by name; exit code 5 where the bytes are no EXR header.
[[nodiscard]] Result<std::map<std::string, std::string>> read_exr_texts(
    std::span<const std::byte> file);

/// Returns the range of the heat map in an EXR of raynest, as --range takes it. Exit code 5 where
/// the file is none; exit code 2 where its range is of another metric than `metric`, or of a
/// difference where `differs` is false, or the other way round.
[[nodiscard]] Result<std::string> read_exr_range(const std::string& path, const std::string& metric,
                                                 bool differs);

}  // namespace raynest::client
