// Errors in the daemon's answers: codes of the protocol, and the mapping from the engine's codes.
#pragma once

#include "engine/result.h"
#include "protocol/errors.h"

#include <tl/expected.hpp>

#include <utility>

namespace raynest::server {

/// The result of a handler or a task: a value, or the error that the client receives.
template <class T>
using Reply = protocol::Result<T>;

using protocol::Code;

/// Makes an error: `return refuse(Code::busy, "...")` in any function that returns a Reply.
[[nodiscard]] inline tl::unexpected<protocol::Error> refuse(Code code, std::string message) {
    return protocol::fail(code, std::move(message));
}

/// Converts an engine error into a protocol error.
[[nodiscard]] protocol::Error to_wire(Error error);

/// Returns the error that a client may read. The text of a defect may hold paths of this machine
/// and stays in the log, where the request's id finds it.
[[nodiscard]] protocol::Error for_client(const protocol::Error& error);

/// Returns a text in which files have their names alone: clients are not told folders of this
/// machine.
[[nodiscard]] std::string without_folders(std::string text);

/// Converts an engine error: `return refuse(engine_result.error())`.
[[nodiscard]] inline tl::unexpected<protocol::Error> refuse(Error error) {
    return tl::unexpected<protocol::Error>(to_wire(std::move(error)));
}

}  // namespace raynest::server
