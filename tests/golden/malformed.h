// Frames that a daemon must refuse, with what it must answer: the table that the decoder's unit
// test and the daemon's integration test both replay.
#pragma once

#include "protocol/errors.h"

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

namespace raynest::golden {

struct Malformed {
    std::string name;              ///< says what is wrong
    std::vector<std::byte> bytes;  ///< sent after a good greeting
    protocol::Code code;           ///< in the ERROR frame that answers
    bool closes;                   ///< framing is lost: the connection ends after the ERROR
    bool needs_query;              ///< belongs to a Query of two rays that is under way as query_id
};

inline constexpr std::uint64_t query_id = 7;

/// At least 200, the same on every call.
std::vector<Malformed> malformed_frames();

/// The control part of a VariantList of 32 KiB that is half a million tables to a verifier without
/// limits: all its lists name the same table.
std::vector<std::byte> table_bomb();

}  // namespace raynest::golden
