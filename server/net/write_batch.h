// The frames of one gathered write, and how much of them was sent.
#pragma once

#include "protocol/frame.h"
#include "server/net/asio.h"

#include <array>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <vector>

namespace raynest::server {

/// Up to 16 frames for one gathered write.
class WriteBatch {
public:
    /// The buffers that were not sent yet; valid until the batch changes.
    struct Rest {
        using value_type = asio::const_buffer;
        const asio::const_buffer* first;
        const asio::const_buffer* last;
        [[nodiscard]] const asio::const_buffer* begin() const { return first; }
        [[nodiscard]] const asio::const_buffer* end() const { return last; }
    };

    [[nodiscard]] bool empty() const { return frames_.empty(); }
    [[nodiscard]] Rest rest() const {
        return {buffers_.data() + buffers_sent_, buffers_.data() + buffers_.size()};
    }

    /// Takes the next frames from the outbox. The batch must be empty.
    void load(std::deque<protocol::Frame>& outbox);
    /// Counts `bytes` of rest() as sent, and calls `sent(frame)` for each frame that is now
    /// completely sent. The batch is empty after its last frame.
    template <class Sent>
    void consume(std::size_t bytes, Sent sent) {
        skip(bytes);
        while (frames_left_ < frames_.size() && ends_[frames_left_] <= buffers_sent_)
            sent(frames_[frames_left_++]);
        if (frames_left_ == frames_.size()) clear();
    }

private:
    void skip(std::size_t bytes);
    void clear();

    static constexpr std::size_t frames_max = 16;
    static constexpr std::uint64_t bytes_max = 1ULL << 20;
    std::vector<protocol::Frame> frames_;
    std::array<std::array<std::byte, protocol::header_bytes>, frames_max> headers_;
    std::vector<asio::const_buffer> buffers_;
    std::array<std::size_t, frames_max> ends_;  ///< number of buffers up to each frame's end
    std::size_t buffers_sent_ = 0;              ///< number of buffers sent
    std::size_t frames_left_ = 0;               ///< number of frames sent
};

}  // namespace raynest::server
