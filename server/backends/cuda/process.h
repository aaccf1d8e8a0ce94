// One life of the device worker, seen from the daemon.
#pragma once

#include "server/backends/cuda/channel.h"
#include "server/backends/cuda/wire.h"
#include "server/store/budget.h"

#include <atomic>
#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace raynest::server::device {

/// Of --memory, what slots may take: the rest is for scenes and jobs.
constexpr std::uint64_t slots_share(std::uint64_t memory) {
    return memory / 4;
}

/// Killed, if it still lives, when the last one forgets it. Thread-safe but for one slot.
class Process {
public:
    struct Setup {
        std::vector<std::string> command;  ///< ends up in run_worker_process()
        std::uint32_t slots = 1;           ///< at most slots_max
        SlotShape shape;
        Budget* budget = nullptr;              ///< that the memory of its slots is of
        std::chrono::milliseconds patience{};  ///< for its start
        const std::atomic<bool>* stop;         ///< gives up the start
    };
    /// Blocking. The error says why there is no device (pack_invalid), or no process.
    static Result<std::shared_ptr<Process>> start(const Setup& setup);
    ~Process();
    Process(const Process&) = delete;

    [[nodiscard]] const Ready& ready() const { return *ready_; }
    [[nodiscard]] const SlotShape& shape() const { return shape_; }
    [[nodiscard]] SlotMemory memory(std::uint32_t slot) const {
        return {memory_.bytes().data(), shape_, slot};
    }

    /// Blocking: what the worker answers to a slot's request. Fails where it ended or took too
    /// long.
    Result<Outcome> ask(std::uint32_t slot, const Request& request,
                        std::chrono::milliseconds patience, std::span<const int> files = {});

    /// So that no thread waits for it any more.
    void kill();
    /// How it ended, in words; nothing while it lives.
    [[nodiscard]] std::optional<std::string> end() const;

private:
    explicit Process(const SlotShape& shape) : shape_(shape) {}
    Result<void> share_memory(const Setup& setup);
    /// What the slots' memory takes, of the budget.
    Result<void> reserve(const Setup& setup);
    Result<void> greet(const Setup& setup, Channel control);
    /// Waits a little for its end. Gives how it ended, in words.
    std::string reap() const;

    const SlotShape shape_;
    Budget::Lease lease_;
    Fd memory_file_;
    Mapping memory_;
    pid_t pid_ = -1;
    std::optional<Channel> control_;  ///< once started: closing it ends the worker
    std::vector<Channel> slots_;
    std::unique_ptr<Ready> ready_;
};

}  // namespace raynest::server::device
