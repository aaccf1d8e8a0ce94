// Errors of the protocol and exit codes of the command line, as errors.def lists them.
#pragma once

#include <tl/expected.hpp>

#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <utility>

namespace raynest::protocol {

enum class Code : std::uint32_t {
#define RAYNEST_ERROR(number, NAME, name, ...) name = number,
#include "protocol/lists/errors.def"
};

/// Exit codes of `raynest` (PROTOCOL.md §9).
enum class Exit : int {
#define RAYNEST_EXIT(number, name, ...) name = number,
#include "protocol/lists/errors.def"
};

struct ErrorInfo {
    Code code;
    std::string_view name;
    Exit exit;
    std::string_view remedy;
};
struct ExitInfo {
    Exit code;
    std::string_view text;
};

/// All codes, in order.
[[nodiscard]] std::span<const ErrorInfo> error_table();
[[nodiscard]] std::span<const ExitInfo> exit_table();
/// A number that this version does not know reads as `internal`.
[[nodiscard]] const ErrorInfo& error_info(Code code);

struct Error {
    Code code = Code::internal;
    std::string message;
    std::uint32_t retry_after_ms = 0;
};

template <class T>
using Result = tl::expected<T, Error>;

/// `return fail(Code::bad_frame, "...")` from any function that returns a Result.
[[nodiscard]] inline tl::unexpected<Error> fail(Code code, std::string message) {
    return tl::unexpected<Error>(Error{code, std::move(message), 0});
}

}  // namespace raynest::protocol
