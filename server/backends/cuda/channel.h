// A pair of sockets between two processes that carries whole messages of fixed size.
#pragma once

#include "engine/assets/child_process.h"

#include <chrono>
#include <cstddef>
#include <span>
#include <vector>

namespace raynest::server::device {

enum class Received { message, nothing_in_time, closed };

/// One end. One thread at a time.
class Channel {
public:
    explicit Channel(Fd socket) : socket_(std::move(socket)) {}

    /// Two ends, both out of the way of a child's descriptors.
    static Result<std::pair<Channel, Channel>> make_pair();

    /// False where the other end is closed. `files` are at most 16, and go along.
    template <class Message>
    bool send(const Message& message, std::span<const int> files = {}) {
        return send_bytes(std::as_bytes(std::span(&message, 1)), files);
    }
    /// A message of another size counts as closed: the other end is not what it should be. Files
    /// that came along are added to `files`, or closed.
    template <class Message>
    Received receive(Message& message, std::chrono::milliseconds patience,
                     std::vector<Fd>* files = nullptr) {
        return receive_bytes(std::as_writable_bytes(std::span(&message, 1)), patience, files);
    }
    static constexpr std::chrono::milliseconds for_ever{-1};

    [[nodiscard]] int get() const { return socket_.get(); }

private:
    bool send_bytes(std::span<const std::byte> bytes, std::span<const int> files);
    Received receive_bytes(std::span<std::byte> bytes, std::chrono::milliseconds patience,
                           std::vector<Fd>* files);

    Fd socket_;
};

}  // namespace raynest::server::device
