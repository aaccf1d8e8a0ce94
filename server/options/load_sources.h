// The sources of --load: a file, a pattern of files (glob(7)), builtin:NAME or root:PATH.
#pragma once

#include <string>
#include <vector>

namespace raynest::server {

/// Returns the files that a pattern stands for, by name, and other sources as they are; empty:
/// there is no such file.
[[nodiscard]] std::vector<std::string> files_of(const std::string& source);

}  // namespace raynest::server
