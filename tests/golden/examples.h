// One good frame of every message of version 1: what the golden bytes, PROTOCOL.md's dumps, the
// truncation tests, the malformed frames and the fuzz seeds are all made from.
#pragma once

#include "protocol/control.h"

#include <cstddef>
#include <string>
#include <vector>

namespace raynest::golden {

struct Example {
    std::string name;  ///< the message's, and what tells a second one of it from the first
    protocol::Frame frame;
};

/// Freshly encoded, in the order of THE LIST; the same values on every call.
std::vector<Example> examples();

/// Frames do not copy themselves.
protocol::Frame copy(const protocol::Frame& frame);

/// The frame as it travels.
std::vector<std::byte> wire_bytes(const protocol::Frame& frame);

/// Opens a frame as whatever its header says: UNKNOWN_TYPE for a type outside of THE LIST.
protocol::Result<void> open_any(const protocol::Frame& frame);

/// Reads every field of a message that open_any() accepts and writes it anew, without its bulk.
/// LIMIT_EXCEEDED when the original shared its strings so often that written out it is too large.
protocol::Result<protocol::Frame> rewrite(const protocol::Frame& frame);

}  // namespace raynest::golden
