// THE error table of the protocol: number, name, exit code of the command line, what to do.
//
// Numbers and names are frozen with version 1. The daemon answers with a code and a message of its
// own; where it has nothing better to say, the remedy of the table is the message.
#pragma once

#include <tl/expected.hpp>

#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <utility>

namespace raynest::protocol {

enum class Code : std::uint32_t {
    bad_frame = 1,        ///< the bytes are not a frame, or the frame comes in the wrong state
    unsupported_version,  ///< no version in common
    unknown_type,         ///< a message this daemon does not know; the connection goes on
    limit_exceeded,       ///< a named limit (limits.h)
    invalid_field,        ///< a field, column, word or number of the request
    invalid_param,        ///< a parameter of an intersector
    variant_unknown,
    scene_unknown,
    scene_invalid,
    name_taken,
    quota,
    busy,
    deadline,
    cancelled,
    not_allowed,
    draining,
    slow_consumer,
    resource_exhausted,
    unsupported,
    internal,
    job_unknown,
};

/// Exit codes of `raynest` (PROTOCOL.md §9).
enum class Exit : int {
    ok = 0,
    failed = 1,
    usage = 2,
    cannot_connect = 3,
    not_allowed = 4,
    invalid = 5,
    busy = 6,
    deadline = 7,
    partial = 8,
    threshold = 9,
    interrupted = 130,
};

struct ErrorInfo {
    Code code;
    std::string_view name;
    Exit exit;
    std::string_view remedy;
};

/// All codes, in order.
[[nodiscard]] std::span<const ErrorInfo> error_table();
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
