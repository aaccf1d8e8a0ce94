// Looks at the file of a shared object before it is loaded: dlopen() maps its segments, and a
// process that touches a mapping beyond the end of its file gets SIGBUS.
#pragma once

#include "engine/result.h"

#include <filesystem>

namespace raynest {

/// Fails with pack_invalid if the file is not regular, or ends before its segments do. Leaves all
/// other faults to dlopen().
Result<void> check_module_file(const std::filesystem::path& path);

}  // namespace raynest
