#include "protocol/blocks.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <string>
#include <utility>

namespace raynest::protocol {
namespace {

/// Valid strides: one to four values of a type, or a ray.
constexpr std::array strides = {1U, 2U, 3U, 4U, 8U, 12U, 16U, 24U, 32U};

/// True for letters that stand in tables, JSON and messages as they are.
bool is_plain(char c) {
    return c > ' ' && c < 0x7F && c != '"' && c != '\\';
}

tl::unexpected<Error> bad_block(std::string_view name, const char* why) {
    return fail(Code::bad_frame, "block '" + std::string(name) + "' " + why);
}

}  // namespace

std::size_t dtype_bytes(wire::Dtype dtype) {
    switch (dtype) {
        case wire::Dtype::u8:
            return 1;
        case wire::Dtype::u64:
            return 8;
        case wire::Dtype::u32:
        case wire::Dtype::f32:
            return 4;
    }
    return 1;
}

std::string_view dtype_name(wire::Dtype dtype) {
    return wire::EnumNameDtype(dtype);
}

Result<std::vector<BlockView>> read_blocks(const Frame& frame, const BlockList* blocks,
                                           const Limits& limits) {
    const std::size_t count = blocks != nullptr ? blocks->size() : 0;
    if (count != frame.header.block_count)
        return fail(Code::bad_frame, "the header counts " +
                                         std::to_string(frame.header.block_count) +
                                         " blocks, the message describes " + std::to_string(count));

    std::vector<BlockView> views;
    views.reserve(count);
    const std::uint64_t bulk_bytes = frame.bulk.size();
    std::uint64_t end = 0;
    for (std::size_t i = 0; i < count; ++i) {
        const wire::Block& block = *blocks->Get(static_cast<flatbuffers::uoffset_t>(i));
        const std::string_view name = text(block.name());
        if (name.empty() || name.size() > limits.name_bytes_max ||
            !std::ranges::all_of(name, is_plain))
            return fail(Code::bad_frame, "a block without a usable name");
        if (block.dtype() > wire::Dtype::MAX) return bad_block(name, "has an unknown dtype");
        const auto is_stride = [&](std::uint32_t stride) { return stride == block.stride(); };
        if (std::none_of(strides.begin(), strides.end(), is_stride) ||
            block.stride() % dtype_bytes(block.dtype()) != 0)
            return bad_block(name, "has an unknown stride");
        // Division, so that no product can wrap.
        if (block.bytes() > bulk_bytes || block.bytes() % block.stride() != 0 ||
            block.bytes() / block.stride() != block.count())
            return bad_block(name, "is not count * stride bytes, or larger than the bulk part");
        if (block.offset() != end) return bad_block(name, "is not where the last one ends");
        if (padded(block.bytes()) > bulk_bytes - end)
            return bad_block(name, "ends beyond the bulk part");
        if (find_block(views, name) != nullptr) return bad_block(name, "comes twice");
        views.push_back({name, block.dtype(), block.stride(), block.count(),
                         frame.bulk.span().subspan(end, block.bytes())});
        end += padded(block.bytes());
    }
    if (end != bulk_bytes) return fail(Code::bad_frame, "bytes behind the last block");
    return views;
}

const BlockView* find_block(std::span<const BlockView> blocks, std::string_view name) {
    for (const BlockView& block : blocks)
        if (block.name == name) return &block;
    return nullptr;
}

Result<BlockView> only_block(std::span<const BlockView> blocks, std::string_view name,
                             wire::Dtype dtype, std::initializer_list<std::uint32_t> strides) {
    if (blocks.size() == 1 && blocks[0].name == name && blocks[0].dtype == dtype &&
        std::ranges::find(strides, blocks[0].stride) != strides.end())
        return blocks[0];
    std::string known;
    for (const std::uint32_t stride : strides)
        known += (known.empty() ? "" : " or ") + std::to_string(stride);
    return fail(Code::invalid_field, "this message carries one block '" + std::string(name) +
                                         "' of " + std::string(dtype_name(dtype)) +
                                         " with a stride of " + known + " bytes");
}

std::size_t Bulk::add(std::string_view name, wire::Dtype dtype, std::uint32_t width,
                      std::uint64_t count) {
    auto block = std::make_unique<wire::BlockT>();
    block->name = name;
    block->dtype = dtype;
    block->count = count;
    block->stride = width * static_cast<std::uint32_t>(dtype_bytes(dtype));
    block->offset = bytes_;
    block->bytes = count * block->stride;
    bytes_ += padded(block->bytes);
    blocks_.push_back(std::move(block));
    return blocks_.size() - 1;
}

void Bulk::allocate() {
    buffer_ = Buffer(bytes_);
    if (bytes_ == 0) return;
    for (const auto& block : blocks_)
        std::memset(buffer_.data() + block->offset + block->bytes, 0,
                    padded(block->bytes) - block->bytes);
}

std::span<std::byte> Bulk::block(std::size_t index) {
    const wire::BlockT& block = *blocks_[index];
    return buffer_.span().subspan(block.offset, block.bytes);
}

}  // namespace raynest::protocol
