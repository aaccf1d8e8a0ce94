// Blocks: the bulk part of a frame as named columns.
//
// Blocks lie one after the other, each padded to 64 bytes, in the order of their descriptions; so a
// description has exactly one right offset, and a receiver need not think about gaps or overlaps.
#pragma once

#include "protocol/frame.h"
#include "protocol/wire.h"

#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <memory>
#include <span>
#include <string_view>
#include <vector>

namespace raynest::protocol {

[[nodiscard]] std::size_t dtype_bytes(wire::Dtype dtype);
/// "u8", "u32", "u64", "f32".
[[nodiscard]] std::string_view dtype_name(wire::Dtype dtype);

/// A received column; points into its frame.
struct BlockView {
    std::string_view name;
    wire::Dtype dtype = wire::Dtype::u8;
    std::uint32_t stride = 0;
    std::uint64_t count = 0;
    std::span<const std::byte> bytes;

    /// Values per element: 2 for uv.
    [[nodiscard]] std::uint32_t width() const {
        return stride / static_cast<std::uint32_t>(dtype_bytes(dtype));
    }
    /// The values as T; the caller has checked dtype.
    template <class T>
    [[nodiscard]] std::span<const T> values() const {
        return {reinterpret_cast<const T*>(bytes.data()), bytes.size() / sizeof(T)};
    }
};

using BlockList = flatbuffers::Vector<flatbuffers::Offset<wire::Block>>;

/// Checks every description against the frame's header and bulk part: dtype and stride known, count
/// * stride == bytes in 64 bits, offsets as above, names unique. BAD_FRAME otherwise.
Result<std::vector<BlockView>> read_blocks(const Frame& frame, const BlockList* blocks,
                                           const Limits& limits);

/// null when there is none.
[[nodiscard]] const BlockView* find_block(std::span<const BlockView> blocks, std::string_view name);

/// The one block of a message that has one: INVALID_FIELD unless it is alone and has this name,
/// dtype and one of these strides.
Result<BlockView> only_block(std::span<const BlockView> blocks, std::string_view name,
                             wire::Dtype dtype, std::initializer_list<std::uint32_t> strides);

/// Lays out the bulk part of a frame to be sent: add() every block, then allocate(), then fill.
class Bulk {
public:
    /// Returns the index of the block. `width` values per element: stride = width * dtype size.
    std::size_t add(std::string_view name, wire::Dtype dtype, std::uint32_t width,
                    std::uint64_t count);
    /// One buffer for all blocks; padding is zero, blocks are not initialised. Throws bad_alloc.
    void allocate();
    [[nodiscard]] std::span<std::byte> block(std::size_t index);
    template <class T>
    [[nodiscard]] std::span<T> block_as(std::size_t index) {
        const std::span<std::byte> bytes = block(index);
        return {reinterpret_cast<T*>(bytes.data()), bytes.size() / sizeof(T)};
    }

    [[nodiscard]] std::uint64_t bytes() const { return bytes_; }
    [[nodiscard]] std::size_t count() const { return blocks_.size(); }
    /// As messages have them: encode() moves them there.
    [[nodiscard]] std::vector<std::unique_ptr<wire::BlockT>>& descriptions() { return blocks_; }
    /// The buffer, for the frame.
    Buffer take() { return std::move(buffer_); }

private:
    std::vector<std::unique_ptr<wire::BlockT>> blocks_;
    std::uint64_t bytes_ = 0;
    Buffer buffer_;
};

}  // namespace raynest::protocol
