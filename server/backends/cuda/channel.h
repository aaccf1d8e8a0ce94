// A socket pair between two processes that carries whole messages of fixed size.
#pragma once

#include "engine/system/child_process.h"

#include <chrono>
#include <cstddef>
#include <span>
#include <vector>

namespace raynest::server::device {

enum class Received { message, nothing_in_time, closed };

/// One end of the pair. Not thread-safe.
class Channel {
public:
    explicit Channel(Fd socket) : socket_(std::move(socket)) {}

    /// Makes both ends. Their descriptors do not collide with those that a child inherits.
    static Result<std::pair<Channel, Channel>> make_pair();

    /// Sends a message with up to 16 file descriptors. Returns false if the other end is closed.
    template <class Message>
    bool send(const Message& message, std::span<const int> files = {}) {
        return send_bytes(std::as_bytes(std::span(&message, 1)), files);
    }
    /// Waits up to `time_limit` for a message. A message of the wrong size counts as closed: the
    /// other end is faulty. Received descriptors are appended to `files`, or closed if it is null.
    template <class Message>
    Received receive(Message& message, std::chrono::milliseconds time_limit,
                     std::vector<Fd>* files = nullptr) {
        return receive_bytes(std::as_writable_bytes(std::span(&message, 1)), time_limit, files);
    }
    static constexpr std::chrono::milliseconds for_ever{-1};

    [[nodiscard]] int get() const { return socket_.get(); }

private:
    bool send_bytes(std::span<const std::byte> bytes, std::span<const int> files);
    Received receive_bytes(std::span<std::byte> bytes, std::chrono::milliseconds time_limit,
                           std::vector<Fd>* files);

    Fd socket_;
};

}  // namespace raynest::server::device
