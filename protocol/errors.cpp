#include "protocol/errors.h"

#include <array>
#include <cstddef>

namespace raynest::protocol {
namespace {

constexpr std::array table = {
    ErrorInfo{Code::bad_frame, "BAD_FRAME", Exit::failed,
              "the bytes are not a frame of this protocol; see PROTOCOL.md"},
    ErrorInfo{Code::unsupported_version, "UNSUPPORTED_VERSION", Exit::cannot_connect,
              "use a client and a daemon that share a protocol version"},
    ErrorInfo{Code::unknown_type, "UNKNOWN_TYPE", Exit::failed,
              "this daemon is older than the client; upgrade raynestd"},
    ErrorInfo{Code::limit_exceeded, "LIMIT_EXCEEDED", Exit::invalid,
              "ask for less; raynestd --print-config shows the limits"},
    ErrorInfo{Code::invalid_field, "INVALID_FIELD", Exit::usage,
              "correct the field that the message names"},
    ErrorInfo{Code::invalid_param, "INVALID_PARAM", Exit::usage,
              "see `Variants`, which lists every parameter and its range"},
    ErrorInfo{Code::variant_unknown, "VARIANT_UNKNOWN", Exit::invalid, "see `Variants`"},
    ErrorInfo{Code::scene_unknown, "SCENE_UNKNOWN", Exit::invalid, "see `Scenes`, or `Load` it"},
    ErrorInfo{Code::scene_invalid, "SCENE_INVALID", Exit::invalid,
              "repair the file as the message says and load it again"},
    ErrorInfo{Code::name_taken, "NAME_TAKEN", Exit::failed,
              "choose another `name`, or pass `replace`"},
    ErrorInfo{Code::quota, "QUOTA", Exit::busy, "wait for your other requests, or unload a scene"},
    ErrorInfo{Code::busy, "BUSY", Exit::busy, "the daemon is full; try again later"},
    ErrorInfo{Code::deadline, "DEADLINE", Exit::deadline,
              "pass a longer `deadline_ms`, or ask for less"},
    ErrorInfo{Code::cancelled, "CANCELLED", Exit::interrupted, "the request was cancelled"},
    ErrorInfo{Code::not_allowed, "NOT_ALLOWED", Exit::not_allowed,
              "it belongs to another principal; ask as its owner"},
    ErrorInfo{Code::draining, "DRAINING", Exit::busy,
              "the daemon is shutting down; try again when it is back"},
    ErrorInfo{Code::slow_consumer, "SLOW_CONSUMER", Exit::failed,
              "read the answers as they come, or ask for fewer columns"},
    ErrorInfo{Code::resource_exhausted, "RESOURCE_EXHAUSTED", Exit::busy,
              "the daemon is out of memory; unload a scene or ask for less"},
    ErrorInfo{Code::unsupported, "UNSUPPORTED", Exit::invalid,
              "this build of the daemon cannot do that"},
    ErrorInfo{Code::internal, "INTERNAL", Exit::failed,
              "a defect of the daemon: please report the message and the daemon's log"},
    ErrorInfo{Code::job_unknown, "JOB_UNKNOWN", Exit::invalid, "see `Jobs` for those there are"},
};

// error_info() indexes by number.
constexpr bool in_order() {
    for (std::size_t i = 0; i < table.size(); ++i)
        if (static_cast<std::size_t>(table[i].code) != i + 1) return false;
    return true;
}
static_assert(in_order());

}  // namespace

std::span<const ErrorInfo> error_table() {
    return table;
}

const ErrorInfo& error_info(Code code) {
    const auto number = static_cast<std::size_t>(code);
    const bool known = number >= 1 && number <= table.size();
    return table[(known ? number : static_cast<std::size_t>(Code::internal)) - 1];
}

}  // namespace raynest::protocol
