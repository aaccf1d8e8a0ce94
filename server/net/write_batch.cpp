#include "server/net/write_batch.h"

#include <algorithm>
#include <utility>

namespace raynest::server {

void WriteBatch::load(std::deque<protocol::Frame>& outbox) {
    std::uint64_t bytes = 0;
    while (!outbox.empty() && frames_.size() < frames_max && bytes < bytes_max) {
        bytes += outbox.front().header.frame_bytes();
        frames_.push_back(std::move(outbox.front()));
        outbox.pop_front();
    }
    for (std::size_t i = 0; i < frames_.size(); ++i) {
        const protocol::Frame& frame = frames_[i];
        protocol::write_header(frame.header, headers_[i]);
        buffers_.emplace_back(headers_[i].data(), headers_[i].size());
        for (const protocol::Buffer* part : {&frame.control, &frame.bulk})
            if (part->size() != 0) buffers_.emplace_back(part->data(), part->size());
        ends_[i] = buffers_.size();
    }
}

void WriteBatch::skip(std::size_t bytes) {
    while (bytes != 0) {
        asio::const_buffer& front = buffers_[buffers_sent_];
        const std::size_t part = std::min(bytes, front.size());
        front += part;
        bytes -= part;
        if (front.size() == 0) ++buffers_sent_;
    }
}

void WriteBatch::clear() {
    frames_.clear();
    buffers_.clear();
    buffers_sent_ = frames_left_ = 0;
}

}  // namespace raynest::server
