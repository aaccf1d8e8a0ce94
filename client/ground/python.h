// Commands that the Python package carries out.
#pragma once

#include "client/ground/failure.h"

#include <string>
#include <vector>

namespace raynest::client {

/// Makes this process `python3`, or what RAYNEST_PYTHON names, which calls main(words) of a module
/// of the package. Returns only where that fails: exit code 1.
Failure become_python(const std::string& module, std::vector<std::string> words);

}  // namespace raynest::client
