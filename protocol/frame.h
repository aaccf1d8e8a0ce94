// Frames: how messages lie in the byte stream, and the decoder that both ends use.
//
//   0       4       8       12      16          24          32        32 + control_bytes
//   +-------+---+---+-------+-------+-----------+-----------+---------+------------------
//   | RYN1  |typ|flg|control|blocks | bulk_bytes| request_id| control | bulk: blocks, each
//   | magic |u16|u16|  u32  |  u32  |    u64    |    u64    |         | padded to 64 bytes
//   +-------+---+---+-------+-------+-----------+-----------+---------+------------------
//
// All little endian. A FrameDecoder takes bytes as they come, in pieces of any size, and allocates
// only from lengths that it has checked; it knows no sockets and no messages.
#pragma once

#include "protocol/buffer.h"
#include "protocol/errors.h"
#include "protocol/limits.h"

#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <utility>

namespace raynest::protocol {

inline constexpr std::size_t header_bytes = 32;
inline constexpr std::uint32_t frame_magic = 0x314E5952;  ///< "RYN1" in the stream

struct FrameHeader {
    std::uint16_t type = 0;   ///< wire::Message, or a type of a later version
    std::uint16_t flags = 0;  ///< none in version 1
    std::uint32_t control_bytes = 0;
    std::uint32_t block_count = 0;
    std::uint64_t bulk_bytes = 0;
    std::uint64_t request_id = 0;  ///< 0: about the connection itself

    [[nodiscard]] std::uint64_t frame_bytes() const {
        return header_bytes + control_bytes + bulk_bytes;
    }
    bool operator==(const FrameHeader&) const = default;
};

void write_header(const FrameHeader& header, std::span<std::byte, header_bytes> out);

/// BAD_FRAME or LIMIT_EXCEEDED: framing is lost, and the connection must end.
Result<FrameHeader> read_header(std::span<const std::byte, header_bytes> bytes,
                                const Limits& limits);

/// One frame in memory, received or to be sent. `control` and `bulk` are 64-byte aligned.
struct Frame {
    FrameHeader header;
    Buffer control;
    Buffer bulk;
};

/// Turns a byte stream into frames. After an error it gives the same error for ever. Not
/// thread-safe; one per direction of a connection.
class FrameDecoder {
public:
    /// `limits` must outlive the decoder; a caller lowers frame_bytes_max until the greeting is
    /// over.
    explicit FrameDecoder(const Limits& limits) : limits_(limits) {}

    void set_frame_bytes_max(std::uint64_t bytes) { frame_bytes_max_ = bytes; }

    /// Asked with every checked header, before memory is taken for its frame: an error ends the
    /// stream, false lets the bulk part pass unread (the frame then comes with an empty one).
    using Admission = std::function<Result<bool>(const FrameHeader&)>;
    void set_admission(Admission admission) { admission_ = std::move(admission); }

    /// Takes bytes of the current frame, at most to its end, and says how many it took. Takes none
    /// while a frame is complete and not yet taken. RESOURCE_EXHAUSTED when memory is out.
    Result<std::size_t> feed(std::span<const std::byte> bytes);

    /// The rest of the current bulk part, to be read into directly; empty outside of one. Saves
    /// the copy of feed() for what makes up nearly all bytes of the protocol.
    [[nodiscard]] std::span<std::byte> room();
    /// `count` bytes of room() were filled.
    void filled(std::size_t count) { received_ += count; }

    /// Is a bulk part on its way?
    [[nodiscard]] bool in_bulk() const { return stage_ == Stage::bulk && !complete(); }
    [[nodiscard]] bool complete() const;
    /// Is the stream between two frames, where it may end?
    [[nodiscard]] bool idle() const { return stage_ == Stage::header && received_ == 0; }
    /// The complete frame; the decoder goes on with the next one.
    Frame take();

private:
    enum class Stage { header, control, bulk };
    Result<void> enter_next_stage();
    [[nodiscard]] std::uint64_t stage_bytes() const;
    [[nodiscard]] std::span<std::byte> target();

    const Limits& limits_;
    std::uint64_t frame_bytes_max_ = ~std::uint64_t{0};
    Admission admission_;
    Stage stage_ = Stage::header;
    std::uint64_t received_ = 0;  ///< bytes of the current stage
    bool bulk_passes_ = false;    ///< nobody wants this bulk part
    std::byte header_[header_bytes] = {};
    Frame frame_;
    std::optional<Error> error_;
};

}  // namespace raynest::protocol
