#include "protocol/frame.h"

#include <algorithm>
#include <bit>
#include <cstring>
#include <new>
#include <string>

namespace raynest::protocol {
namespace {

static_assert(std::endian::native == std::endian::little,
              "columns travel as they lie in memory: a big-endian host needs swaps here");

template <class T>
void put(std::span<std::byte, header_bytes> out, std::size_t offset, T value) {
    std::memcpy(out.data() + offset, &value, sizeof value);
}

template <class T>
T get(std::span<const std::byte, header_bytes> bytes, std::size_t offset) {
    T value;
    std::memcpy(&value, bytes.data() + offset, sizeof value);
    return value;
}

std::string over(const char* what, std::uint64_t value, const char* limit, std::uint64_t most) {
    return std::string(what) + " of " + std::to_string(value) + " bytes is over " + limit + " = " +
           std::to_string(most);
}

}  // namespace

void write_header(const FrameHeader& header, std::span<std::byte, header_bytes> out) {
    put(out, 0, frame_magic);
    put(out, 4, header.type);
    put(out, 6, header.flags);
    put(out, 8, header.control_bytes);
    put(out, 12, header.block_count);
    put(out, 16, header.bulk_bytes);
    put(out, 24, header.request_id);
}

Result<FrameHeader> read_header(std::span<const std::byte, header_bytes> bytes,
                                const Limits& limits) {
    if (get<std::uint32_t>(bytes, 0) != frame_magic)
        return fail(Code::bad_frame, "a frame starts with RYN1; this is not the RayNest protocol");
    FrameHeader header;
    header.type = get<std::uint16_t>(bytes, 4);
    header.flags = get<std::uint16_t>(bytes, 6);
    header.control_bytes = get<std::uint32_t>(bytes, 8);
    header.block_count = get<std::uint32_t>(bytes, 12);
    header.bulk_bytes = get<std::uint64_t>(bytes, 16);
    header.request_id = get<std::uint64_t>(bytes, 24);

    if (header.flags != 0) return fail(Code::bad_frame, "version 1 has no frame flags");
    if (header.control_bytes > limits.control_bytes_max)
        return fail(Code::limit_exceeded, over("a control message", header.control_bytes,
                                               "control_bytes_max", limits.control_bytes_max));
    // Checked alone first, so that the sum below cannot wrap.
    if (header.bulk_bytes > limits.frame_bytes_max)
        return fail(Code::limit_exceeded, over("a bulk part", header.bulk_bytes, "frame_bytes_max",
                                               limits.frame_bytes_max));
    if (header.frame_bytes() > limits.frame_bytes_max)
        return fail(Code::limit_exceeded, over("a frame", header.frame_bytes(), "frame_bytes_max",
                                               limits.frame_bytes_max));
    if (header.block_count > limits.blocks_max)
        return fail(Code::limit_exceeded,
                    "a frame of " + std::to_string(header.block_count) +
                        " blocks is over blocks_max = " + std::to_string(limits.blocks_max));
    if (header.bulk_bytes % alignment != 0)
        return fail(Code::bad_frame, "the bulk part is not padded to 64 bytes");
    if (header.bulk_bytes != 0 && header.block_count == 0)
        return fail(Code::bad_frame, "a bulk part without blocks");
    return header;
}

std::uint64_t FrameDecoder::stage_bytes() const {
    switch (stage_) {
        case Stage::header:
            return header_bytes;
        case Stage::control:
            return frame_.header.control_bytes;
        case Stage::bulk:
            return frame_.header.bulk_bytes;
    }
    return 0;
}

/// Where the rest of the stage goes; not to be asked for a bulk part that passes.
std::span<std::byte> FrameDecoder::target() {
    switch (stage_) {
        case Stage::header:
            return std::span(header_).subspan(received_);
        case Stage::control:
            return frame_.control.span().subspan(received_);
        case Stage::bulk:
            return frame_.bulk.span().subspan(received_);
    }
    return {};
}

Result<std::size_t> FrameDecoder::feed(std::span<const std::byte> bytes) {
    if (error_) return tl::unexpected<Error>(*error_);
    std::size_t taken = 0;
    while (!complete()) {
        // A full stage moves on even without bytes at hand: parts may be empty.
        const std::uint64_t missing = stage_bytes() - received_;
        if (missing == 0) {
            if (Result<void> entered = enter_next_stage(); !entered) {
                error_ = entered.error();
                return tl::unexpected<Error>(*error_);
            }
            continue;
        }
        const std::size_t count = std::min<std::uint64_t>(missing, bytes.size() - taken);
        if (count == 0) break;
        if (stage_ != Stage::bulk || !bulk_passes_)
            std::memcpy(target().data(), bytes.data() + taken, count);
        received_ += count;
        taken += count;
    }
    return taken;
}

Result<void> FrameDecoder::enter_next_stage() {
    try {
        if (stage_ == Stage::header) {
            Result<FrameHeader> header = read_header(header_, limits_);
            if (!header) return tl::unexpected<Error>(header.error());
            if (header->frame_bytes() > frame_bytes_max_)
                return fail(Code::limit_exceeded,
                            over("a frame before the greeting's end", header->frame_bytes(),
                                 "greeting_bytes_max", frame_bytes_max_));
            Result<bool> admitted = true;
            if (admission_) admitted = admission_(*header);
            if (!admitted) return tl::unexpected<Error>(admitted.error());
            bulk_passes_ = !*admitted;
            frame_.header = *header;
            frame_.control = Buffer(header->control_bytes);
            stage_ = Stage::control;
        } else {
            frame_.bulk = Buffer(bulk_passes_ ? 0 : frame_.header.bulk_bytes);
            stage_ = Stage::bulk;
        }
    } catch (const std::bad_alloc&) {
        return fail(Code::resource_exhausted, "no memory for a frame of " +
                                                  std::to_string(frame_.header.frame_bytes()) +
                                                  " bytes; try again later");
    }
    received_ = 0;
    return {};
}

std::span<std::byte> FrameDecoder::room() {
    return stage_ == Stage::bulk && !bulk_passes_ ? target() : std::span<std::byte>{};
}

bool FrameDecoder::complete() const {
    return stage_ == Stage::bulk && received_ == frame_.header.bulk_bytes;
}

Frame FrameDecoder::take() {
    stage_ = Stage::header;
    received_ = 0;
    return std::exchange(frame_, Frame{});
}

}  // namespace raynest::protocol
