// Reads a text as tokens of JSON, before a parser does.
//
// FlatBuffers' parser takes more than JSON, also where it is told to be strict: functions (`sin(1)`),
// bare words, texts in single quotes, and comments. 64 KiB of functions take it 10 ms. Refusing such
// a message must cost next to nothing: this takes 0.08 ms for the worst 64 KiB, nlohmann's sax_parse
// 1.1 ms (65,536 digits).
#pragma once

#include "protocol/limits.h"

#include <cstddef>
#include <string_view>

namespace raynest::server {

/// Quotes and opening square brackets of a text: several full lists of texts.
inline constexpr std::size_t json_marks_max = 4096;
/// Opening braces: all tables that a message may have, and a few vectors in them.
inline constexpr std::size_t json_objects_max = protocol::Limits().control_tables_max + 8;
/// Commas: all values of tables.
inline constexpr std::size_t json_items_max = 10'000;

/// Returns what is wrong with a text; empty if it consists of RFC 8259's tokens within these limits.
/// Whether their order is right is for the parser to say. Linear in the bytes.
[[nodiscard]] std::string_view fault_of_json(std::string_view text);

}  // namespace raynest::server
