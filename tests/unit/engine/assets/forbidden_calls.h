// System calls that a parser in the hands of an attacker would try. In the import child each must
// fail.
#pragma once

#include <string_view>
#include <vector>

namespace raynest::test {

struct ForbiddenCall {
    std::string_view name;
    /// Returns a negative number with errno, or what the call gave. A process that it makes ends.
    long (*attempt)();
};

[[nodiscard]] const std::vector<ForbiddenCall>& forbidden_calls();

}  // namespace raynest::test
