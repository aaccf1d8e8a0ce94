// The import child of the tests, which can also misbehave (import_child_main.cpp).
#pragma once

#include <string>
#include <vector>

namespace raynest::test {

/// Returns its command.
inline std::vector<std::string> child(const char* mode = "--import-child") {
    return {RAYNEST_TEST_IMPORT_CHILD, mode};
}

}  // namespace raynest::test
