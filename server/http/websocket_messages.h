// How frames look as WebSocket messages: control messages are JSON there, which browsers can write.
//
//   text:   "TYPE ID JSON", e.g. `Info 3 {"scene":"forest"}`     a frame without blocks
//   binary: header, JSON, bulk part                              control_bytes is that of the JSON
//
// The JSON has the fields of messages.fbs under their names. Everything after the conversion is as
// on TCP: the bytes that come out are verified like any other control message. Only
// websocket_messages.cpp includes FlatBuffers' parser.
#pragma once

#include "protocol/frame.h"
#include "server/net/unreadable.h"

#include <span>
#include <string>
#include <string_view>

namespace raynest::server {

template <class Value>
using Read = tl::expected<Value, Unreadable>;

// The functions below are thread-safe.

/// Reads a text message.
Read<protocol::Frame> read_text_message(std::string_view message);
/// Reads the header and JSON of a binary message; the frame's bulk part is left empty, while its
/// header still announces it.
Read<protocol::Frame> read_binary_message(const protocol::FrameHeader& header,
                                          std::string_view json);
/// Returns a frame's message without its bulk part: a text message if it has no blocks.
[[nodiscard]] std::string write_message(const protocol::FrameHeader& header,
                                        std::span<const std::byte> control);

}  // namespace raynest::server
