// The write under way: frames as one sequence of buffers, and how much of it has left.
#pragma once

#include "protocol/frame.h"
#include "server/net/asio.h"

#include <array>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <span>
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
    [[nodiscard]] std::span<const protocol::Frame> frames() const { return frames_; }
    [[nodiscard]] Rest rest() const {
        return {buffers_.data() + left_, buffers_.data() + buffers_.size()};
    }

    /// Takes the next frames of the outbox; only when empty.
    void load(std::deque<protocol::Frame>& outbox);
    /// So many bytes have left. Empty again with the last one.
    void consume(std::size_t bytes);

private:
    static constexpr std::size_t frames_max = 16;
    static constexpr std::uint64_t bytes_max = 1ULL << 20;
    std::vector<protocol::Frame> frames_;
    std::array<std::array<std::byte, protocol::header_bytes>, frames_max> headers_;
    std::vector<asio::const_buffer> buffers_;
    std::size_t left_ = 0;  ///< buffers that have left
};

}  // namespace raynest::server
