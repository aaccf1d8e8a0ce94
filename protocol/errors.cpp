#include "protocol/errors.h"

#include <array>
#include <cstddef>

namespace raynest::protocol {
namespace {

constexpr std::array errors = {
#define RAYNEST_ERROR(number, NAME, name, exit, remedy) \
    ErrorInfo{Code::name, #NAME, Exit::exit, remedy},
#include "protocol/lists/errors.def"
};

constexpr std::array exits = {
#define RAYNEST_EXIT(number, name, text) ExitInfo{Exit::name, text},
#include "protocol/lists/errors.def"
};

// error_info() indexes by number.
constexpr bool in_order() {
    for (std::size_t i = 0; i < errors.size(); ++i)
        if (static_cast<std::size_t>(errors[i].code) != i + 1) return false;
    return true;
}
static_assert(in_order());

}  // namespace

std::span<const ErrorInfo> error_table() {
    return errors;
}

std::span<const ExitInfo> exit_table() {
    return exits;
}

const ErrorInfo& error_info(Code code) {
    const auto number = static_cast<std::size_t>(code);
    const bool known = number >= 1 && number <= errors.size();
    return errors[(known ? number : static_cast<std::size_t>(Code::internal)) - 1];
}

}  // namespace raynest::protocol
