// Messages with every field of their table set, made from the schema itself: a field that is added
// to messages.fbs is in them without being listed anywhere.
#pragma once

#include "protocol/control.h"

#include <cstddef>
#include <string>
#include <vector>

namespace raynest::golden {

/// The tables that travel, in the order of their numbers.
std::vector<wire::Message> message_types();

struct FullMessage {
    protocol::Frame frame;           ///< without bulk: `blocks` stay empty
    std::vector<std::string> texts;  ///< "job.scene": where each string lies
};

inline constexpr std::size_t no_text = ~std::size_t{0};

/// Numbers are 1, lists have one element, and all of it is acceptable to open(); but texts[spoilt]
/// holds a control character.
FullMessage full_message(wire::Message type, std::size_t spoilt = no_text);

}  // namespace raynest::golden
