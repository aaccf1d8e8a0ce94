// Errors as the daemon answers them: the protocol's table, and the one place that maps the engine's
// codes into it.
#pragma once

#include "engine/result.h"
#include "protocol/errors.h"

#include <tl/expected.hpp>

#include <utility>

namespace raynest::server {

/// What a handler or a task gives back: a value, or the error that the client will read.
template <class T>
using Reply = protocol::Result<T>;

using protocol::Code;

/// `return refuse(Code::busy, "...")` from any function that returns a Reply.
[[nodiscard]] inline tl::unexpected<protocol::Error> refuse(Code code, std::string message) {
    return protocol::fail(code, std::move(message));
}

/// An engine error in the wire's words.
[[nodiscard]] protocol::Error to_wire(Error error);

/// `return refuse(engine_result.error())`.
[[nodiscard]] inline tl::unexpected<protocol::Error> refuse(Error error) {
    return tl::unexpected<protocol::Error>(to_wire(std::move(error)));
}

}  // namespace raynest::server
