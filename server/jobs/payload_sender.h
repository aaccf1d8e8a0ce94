// The one payload of a job's answer, sent in pieces under credit: PICTURE frames.
#pragma once

#include "protocol/limits.h"
#include "server/documents/payload.h"
#include "server/scheduling/job.h"
#include "server/security/caller.h"

#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <string>

namespace raynest::server {

/// Returns the maximum bytes of the frames that carry a payload.
[[nodiscard]] std::uint64_t payload_answer_bytes(const Caller& caller, std::uint64_t payload_bytes);

class PayloadSender {
public:
    PayloadSender(const protocol::Limits& limits, const Caller& caller, std::string encode);

    /// Sets the payload. May be called by the task that made it.
    /// Replaces an earlier payload, which must have been sent.
    void set(Payload payload) {
        payload_ = std::move(payload);
        total_ = payload_.bytes.size();
        read_ = {};
        sent_ = 0;
    }
    /// Copies the bytes of a payload from this offset on. Called by tasks.
    using Read = std::function<Reply<void>(std::uint64_t offset, std::span<std::byte> into)>;
    /// The same for one of `total` bytes that is not whole in memory; `payload` has no bytes.
    void set(Payload payload, std::uint64_t total, Read read) {
        set(std::move(payload));
        total_ = total;
        read_ = std::move(read);
    }
    /// Returns the next task, or nothing while one runs: pieces leave in order.
    std::optional<Task> next();
    /// Called when a task has ended.
    void ended() { running_ = false; }
    [[nodiscard]] bool finished() const { return sent_ == total_; }
    [[nodiscard]] std::uint64_t sent() const { return sent_; }
    [[nodiscard]] std::uint64_t total() const { return total_; }

private:
    Reply<Frames> make_piece(std::uint64_t offset, std::uint64_t count) const;

    const protocol::Limits& limits_;
    const std::uint64_t id_;
    const std::uint64_t piece_bytes_;
    const std::string encode_;
    Payload payload_;
    Read read_;  ///< null: of payload_
    std::uint64_t total_ = 0;
    bool running_ = false;
    std::uint64_t sent_ = 0;
};

}  // namespace raynest::server
