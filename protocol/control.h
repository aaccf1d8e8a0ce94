// Control messages: encode() makes a frame of a message, open() reads one out of a frame.
//
// The type in the header follows from the table's place in THE LIST (union Message, messages.fbs),
// so no other file lists messages. Whatever open() returns has been verified by FlatBuffers under
// our limits, and its strings, lists and numbers by validate.h: a handler only asks what they mean.
#pragma once

#include "protocol/blocks.h"
#include "protocol/frame.h"
#include "protocol/validate.h"
#include "protocol/wire.h"

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace raynest::protocol {

template <class Table>
inline constexpr wire::Message message_of = wire::MessageTraits<Table>::enum_value;

/// A message that arrived; `table` points into the frame's control part, `blocks` into its bulk
/// part, so the frame must outlive it.
template <class Table>
struct Opened {
    const Table* table = nullptr;
    std::vector<BlockView> blocks;
    const Table* operator->() const { return table; }
};

/// "Query", or "type 777" for what this version does not know.
[[nodiscard]] std::string message_name(std::uint16_t type);
[[nodiscard]] bool message_known(std::uint16_t type);
/// True if clients may send messages of this type.
[[nodiscard]] inline bool sent_by_client(std::uint16_t type) {
    return message_known(type) && type < 128;
}

using StringList = flatbuffers::Vector<flatbuffers::Offset<flatbuffers::String>>;
[[nodiscard]] std::vector<std::string> strings(const StringList* list);
/// The values of a table, in the message's own bytes.
[[nodiscard]] std::span<const float> values(const wire::ParamTable& table);

/// Copies a finished message into a frame of this header, as far as that describes type, request
/// and bulk part, which it lacks; LIMIT_EXCEEDED naming the message when it is too large.
Result<Frame> seal(const FrameHeader& header, const flatbuffers::FlatBufferBuilder& message,
                   const Limits& limits);

/// Makes a frame of a message with `blocks`, described by `bulk`, and moves the buffer of `bulk`
/// into it. If `bulk` has none, the caller must send the bytes after the frame.
template <class Native>
Result<Frame> encode(std::uint64_t request_id, Native message, Bulk&& bulk,
                     const Limits& limits = Limits{}) {
    using Table = typename Native::TableType;
    FrameHeader header;
    header.type = static_cast<std::uint16_t>(message_of<Table>);
    header.block_count = static_cast<std::uint32_t>(bulk.count());
    header.bulk_bytes = bulk.bytes();
    header.request_id = request_id;
    message.blocks = std::move(bulk.descriptions());
    flatbuffers::FlatBufferBuilder builder;
    builder.Finish(Table::Pack(builder, &message));
    Result<Frame> frame = seal(header, builder, limits);
    if (frame) frame->bulk = bulk.take();
    return frame;
}

/// A frame of a message without bulk: encode(id, wire::InfoT{...}).
template <class Native>
Result<Frame> encode(std::uint64_t request_id, const Native& message,
                     const Limits& limits = Limits{}) {
    using Table = typename Native::TableType;
    FrameHeader header;
    header.type = static_cast<std::uint16_t>(message_of<Table>);
    header.request_id = request_id;
    flatbuffers::FlatBufferBuilder builder;
    builder.Finish(Table::Pack(builder, &message));
    return seal(header, builder, limits);
}

/// The ERROR frame; an empty message becomes the table's remedy. Never fails: an overlong message
/// is cut.
Frame encode_error(std::uint64_t request_id, const Error& error, bool closing);

/// The message of a frame whose header says that it is a Table. BAD_FRAME when the bytes are no
/// such table, LIMIT_EXCEEDED or INVALID_FIELD when its contents are out of bounds.
template <class Table>
Result<Opened<Table>> open(const Frame& frame, const Limits& limits = Limits{}) {
    if (frame.header.type != static_cast<std::uint16_t>(message_of<Table>))
        return fail(Code::bad_frame,
                    "expected " + message_name(static_cast<std::uint16_t>(message_of<Table>)) +
                        ", got " + message_name(frame.header.type));
    flatbuffers::Verifier verifier(reinterpret_cast<const std::uint8_t*>(frame.control.data()),
                                   frame.control.size(),
                                   static_cast<flatbuffers::uoffset_t>(limits.control_depth_max),
                                   static_cast<flatbuffers::uoffset_t>(limits.control_tables_max));
    if (frame.control.size() > limits.control_bytes_max || !verifier.VerifyBuffer<Table>(nullptr))
        return fail(Code::bad_frame,
                    "the control part is not a valid " + message_name(frame.header.type));

    Opened<Table> opened;
    opened.table = flatbuffers::GetRoot<Table>(frame.control.data());
    const BlockList* described = nullptr;
    if constexpr (requires { opened.table->blocks(); }) described = opened.table->blocks();
    Result<std::vector<BlockView>> blocks = read_blocks(frame, described, limits);
    if (!blocks) return tl::unexpected<Error>(blocks.error());
    opened.blocks = std::move(*blocks);
    if (Result<void> valid = validate(*opened.table, limits); !valid)
        return tl::unexpected<Error>(valid.error());
    return opened;
}

}  // namespace raynest::protocol
