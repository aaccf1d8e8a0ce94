// A file that a client sends with a request, piece by piece: UPLOAD frames.
#pragma once

#include "protocol/buffer.h"
#include "protocol/control.h"
#include "protocol/frame.h"
#include "protocol/wire.h"
#include "server/ground/errors.h"
#include "server/scheduling/job.h"

#include <atomic>
#include <cstdint>
#include <cstring>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

namespace raynest::server {

/// Copies the data of UPLOAD frames to their places. The io thread copies small ones at once; large
/// ones wait for a task.
class UploadCopies {
public:
    /// Copies `data`, which lies in `frame`, to `to` sooner or later. Returns the bulk bytes that
    /// were freed at once.
    std::uint64_t add(std::span<const std::byte> data, std::byte* to, protocol::Frame frame) {
        // New pages included, 0.02 to 0.6 ms: a virtual machine takes 4 us for each page.
        constexpr std::size_t copied_at_once_max = 1 << 17;
        if (data.size() > copied_at_once_max) {
            waiting_.push_back({data, to, std::move(frame)});
            return 0;
        }
        if (!data.empty()) std::memcpy(to, data.data(), data.size());
        return frame.header.bulk_bytes;
    }
    [[nodiscard]] bool all_copied() const { return waiting_.empty() && running_.empty(); }
    /// Returns the task that copies what waits; nothing while one runs.
    std::optional<Task> next() {
        if (waiting_.empty() || !running_.empty()) return std::nullopt;
        running_.swap(waiting_);
        Task task;
        task.run = [this](const Stop&) {
            for (Copy& copy : running_) {
                std::memcpy(copy.to, copy.data.data(), copy.data.size());
                copy.frame.bulk = {};
                freed_ += copy.frame.header.bulk_bytes;
            }
            return Reply<Frames>(Frames{});
        };
        return task;
    }
    void ended() { running_.clear(); }
    /// Returns the bulk bytes that tasks have freed since the last call.
    [[nodiscard]] std::uint64_t take_freed() { return freed_.exchange(0); }

private:
    struct Copy {
        std::span<const std::byte> data;
        std::byte* to;
        protocol::Frame frame;
    };
    std::vector<Copy> waiting_;
    std::vector<Copy> running_;
    std::atomic<std::uint64_t> freed_{0};
};

/// Room for a file of a size that is known before.
class ReceivedFile {
public:
    ReceivedFile(std::uint32_t number, std::uint64_t bytes) : number_(number), bytes_(bytes) {}

    [[nodiscard]] bool complete() const { return received_ == bytes_.size(); }
    [[nodiscard]] std::span<const std::byte> bytes() const { return bytes_.span(); }
    [[nodiscard]] std::uint64_t received() const { return received_; }
    /// Returns the place of the next piece; fails with INVALID_FIELD if this is not the next one.
    Reply<std::byte*> place(const wire::Upload& piece, std::uint64_t bytes) {
        if (piece.file() != number_ || piece.offset() != received_)
            return refuse(Code::invalid_field, "expected byte " + std::to_string(received_) +
                                                   " of file " + std::to_string(number_) + " next");
        if (bytes > bytes_.size() - received_)
            return refuse(Code::invalid_field, "file " + std::to_string(number_) +
                                                   " is longer than its announced " +
                                                   std::to_string(bytes_.size()) + " bytes");
        received_ += bytes;
        return bytes_.data() + received_ - bytes;
    }
    /// Frees the memory.
    void drop() {
        bytes_ = {};
        received_ = 0;
    }

private:
    std::uint32_t number_;
    protocol::Buffer bytes_;
    std::uint64_t received_ = 0;
};

}  // namespace raynest::server
