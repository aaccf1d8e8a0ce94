// Frames of answers, whose size may depend on what a client has sent.
#pragma once

#include "protocol/control.h"

#include <utility>

namespace raynest::protocol {

/// encode(), or the ERROR frame that says why it failed: an answer that is too large for a frame ends its
/// request, and nothing else.
template <class Native>
Frame answer(std::uint64_t request_id, const Native& message) {
    auto frame = encode(request_id, message);
    return frame ? std::move(*frame) : encode_error(request_id, frame.error(), false);
}

}  // namespace raynest::protocol
