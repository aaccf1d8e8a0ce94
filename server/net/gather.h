// The write under way: frames as one sequence of buffers, and how much of it has left.
#pragma once

#include "protocol/frame.h"
#include "server/net/asio.h"

#include <array>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <vector>

namespace raynest::server {

class Gather {
public:
    /// What has not left, for a gathering write; valid until the next call.
    struct Rest {
        using value_type = asio::const_buffer;
        const asio::const_buffer* first;
        const asio::const_buffer* last;
        [[nodiscard]] const asio::const_buffer* begin() const { return first; }
        [[nodiscard]] const asio::const_buffer* end() const { return last; }
    };

    [[nodiscard]] bool empty() const { return frames_.empty(); }
    [[nodiscard]] Rest rest() const {
        return {buffers_.data() + left_, buffers_.data() + buffers_.size()};
    }

    /// Takes the next frames of the outbox; only when empty.
    void load(std::deque<protocol::Frame>& outbox);
    /// So many bytes have left; gives `left` each frame whose last one was among them. Empty again
    /// with the last frame.
    template <class Left>
    void consume(std::size_t bytes, Left left) {
        skip(bytes);
        while (frames_left_ < frames_.size() && ends_[frames_left_] <= left_)
            left(frames_[frames_left_++]);
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
    std::array<std::size_t, frames_max> ends_;  ///< of each frame: the buffers before and in it
    std::size_t left_ = 0;                      ///< buffers that have left
    std::size_t frames_left_ = 0;
};

}  // namespace raynest::server
