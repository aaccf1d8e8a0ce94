// The engine's error type and Result<T>.
//
// Expected failures (a bad file, an unknown variant) are values, never exceptions. The server maps
// these codes to the wire's table in one function; the message tells the user what to do.
#pragma once

#include <tl/expected.hpp>

#include <cstdint>
#include <string>
#include <utility>

namespace raynest {

enum class ErrorCode : std::uint32_t {
    internal = 1,       ///< a defect of ours: the message names the place
    scene_invalid,      ///< a file or a scene description that cannot be used
    scene_unsupported,  ///< a valid file that needs something this build does not have
    limit_exceeded,     ///< a named limit was reached (PROTOCOL.md §10)
    variant_unknown,    ///< no such intersector, or not for this query, precision or target
    param_invalid,      ///< an intersector parameter is unknown or out of range
    field_invalid,      ///< a column is unknown or not defined for this query
    pack_invalid,       ///< a kernel pack does not load, or does not fit this build
    out_of_memory,
    io_failed,  ///< the operating system refused: the message says what
};
inline constexpr ErrorCode last_error_code = ErrorCode::io_failed;

struct Error {
    ErrorCode code = ErrorCode::internal;
    std::string message;
};

template <class T>
using Result = tl::expected<T, Error>;

/// `return fail(ErrorCode::scene_invalid, "...")` from any function that returns a Result.
[[nodiscard]] inline tl::unexpected<Error> fail(ErrorCode code, std::string message) {
    return tl::unexpected<Error>(Error{code, std::move(message)});
}

}  // namespace raynest
