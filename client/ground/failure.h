// Failures of the client: the daemon's errors, and a few of its own.
//
// A Failure has its exit code and its text for stderr, plain or as JSON, so that commands only
// pass it on.
#pragma once

#include "protocol/errors.h"

#include <tl/expected.hpp>

#include <cstdint>
#include <string>
#include <string_view>
#include <utility>

namespace raynest::client {

using protocol::Exit;

struct Failure {
    Exit exit = Exit::failed;
    std::uint32_t code = 0;  ///< from the protocol's table; 1000 + exit code for the client's own
    std::string name;
    std::string message;
    std::uint32_t retry_after_ms = 0;
    std::string request = {};  ///< id of the request, as in the daemon's log; empty: about none
    bool lost = false;         ///< the connection or its daemon ended: another one may answer
    bool silent = false;       ///< `lost`, because nothing came in answer to a greeting
    bool has_lines = false;    ///< the message is the client's own advice, of several lines
};

template <class T>
using Result = tl::expected<T, Failure>;

/// Converts an error of the protocol, sent by the daemon or found while decoding.
[[nodiscard]] Failure failure(const protocol::Error& error);
/// True for a failure of the client itself or of its connection, not an answer of the daemon.
[[nodiscard]] bool is_own(const Failure& failure);
/// Makes a failure of the client itself.
[[nodiscard]] Failure failure(Exit exit, std::string message);
/// Makes the failure of a connection that ended or fell silent.
[[nodiscard]] Failure lost(Exit exit, std::string message);
[[nodiscard]] inline tl::unexpected<Failure> fail(Exit exit, std::string message) {
    return tl::unexpected<Failure>(failure(exit, std::move(message)));
}

/// Makes the failure of a daemon that breaks the protocol; `what` says what it sent. It is never the
/// user's mistake.
[[nodiscard]] inline tl::unexpected<Failure> daemon_sent(const std::string& what) {
    return fail(Exit::failed, "the daemon sent " + what);
}

/// Returns one line without a line break: "raynest: ... [request ID]", or
/// {"error":{"code","name","message","request"}}.
[[nodiscard]] std::string describe(const Failure& failure, bool json);

/// Prints "raynest: NOTE" on stderr, as shown_text().
void print_note(std::string_view note);

}  // namespace raynest::client
