#include "server/jobs/payload_sender.h"

#include "protocol/blocks.h"
#include "protocol/control.h"

#include <algorithm>
#include <cstring>
#include <utility>

namespace raynest::server {
namespace {

constexpr std::uint64_t piece_bytes_max = 1ULL << 20;

/// Bytes of header, control message and padding of a frame with a piece of the payload.
constexpr std::uint64_t piece_overhead_bytes = 512;

std::uint64_t piece_bytes(const Caller& caller) {
    return std::min(piece_bytes_max, caller.window_bytes / 2);
}

}  // namespace

std::uint64_t payload_answer_bytes(const Caller& caller, std::uint64_t payload_bytes) {
    const std::uint64_t pieces = payload_bytes / (piece_bytes(caller) - protocol::alignment) + 1;
    return payload_bytes + pieces * piece_overhead_bytes;
}

PayloadSender::PayloadSender(const protocol::Limits& limits, const Caller& caller,
                             std::string encode)
    : limits_(limits),
      id_(caller.request_id),
      piece_bytes_(piece_bytes(caller)),
      encode_(std::move(encode)) {}

std::optional<Task> PayloadSender::next() {
    if (running_ || finished()) return std::nullopt;
    const std::uint64_t offset = sent_;
    const std::uint64_t count =
        std::min<std::uint64_t>(piece_bytes_ - protocol::alignment, total_ - offset);
    sent_ += count;
    running_ = true;
    Task task;
    task.reply_bytes_max = protocol::padded(count);
    task.run = [this, offset, count](const Stop&) { return make_piece(offset, count); };
    return task;
}

Reply<Frames> PayloadSender::make_piece(std::uint64_t offset, std::uint64_t count) const {
    protocol::Bulk bulk;
    bulk.add("data", wire::Dtype::u8, 1, count);
    bulk.allocate();
    if (!read_)
        std::memcpy(bulk.block(0).data(), payload_.bytes.data() + offset, count);
    else if (const auto read = read_(offset, bulk.block(0)); !read)
        return tl::unexpected(read.error());
    wire::PayloadT message;
    message.width = payload_.width;
    message.height = payload_.height;
    message.encode = encode_;
    message.offset = offset;
    message.total = total_;
    message.samples = payload_.samples;
    message.last = payload_.last;
    message.exposure = payload_.exposure;
    auto frame = protocol::encode(id_, std::move(message), std::move(bulk), limits_);
    if (!frame) return tl::unexpected(frame.error());
    Frames frames;
    frames.push_back(std::move(*frame));
    return frames;
}

}  // namespace raynest::server
