// The daemon's handle of one device worker process, from its start to its end.
#pragma once

#include "server/backends/cuda/channel.h"
#include "server/backends/cuda/wire.h"
#include "server/ground/budget.h"

#include <atomic>
#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

namespace raynest::server::device {

/// Returns the part of --memory that slots may take; the rest is for scenes and jobs.
constexpr std::uint64_t slots_share(std::uint64_t memory) {
    return memory / 4;
}

/// A running worker process; the destructor kills it. Thread-safe, except that each slot serves one
/// thread at a time.
class Process {
public:
    struct Setup {
        std::vector<std::string> command;  ///< a program that calls run_worker_process()
        std::uint32_t slots = 1;           ///< at most slots_max
        SlotShape shape;
        Budget* budget = nullptr;                ///< the slots' memory is reserved from it
        std::chrono::milliseconds time_limit{};  ///< time limit of the start
        const std::atomic<bool>* stop;           ///< true: give up the start
    };
    /// Starts a process. Blocking. Fails with pack_invalid if there is no device, with other codes
    /// if there is no process.
    static Result<std::shared_ptr<Process>> start(const Setup& setup);
    ~Process();
    Process(const Process&) = delete;

    [[nodiscard]] const Ready& ready() const { return *ready_; }
    [[nodiscard]] const SlotShape& shape() const { return shape_; }
    [[nodiscard]] SlotMemory memory(std::uint32_t slot) const {
        return {memory_.bytes().data(), shape_, slot};
    }

    /// Sends a request to a slot and returns the worker's answer. Blocking. Fails if the worker
    /// ended or did not answer within `time_limit`.
    Result<Outcome> ask(std::uint32_t slot, const Request& request,
                        std::chrono::milliseconds time_limit, std::span<const int> files = {});

    /// Names of the scenes that it was given (Snapshot::arena_id()), some of which it may have
    /// evicted. For upload() alone, which runs once at a time.
    [[nodiscard]] std::set<std::string>& given() { return given_; }

    /// Kills the process, which ends all calls of ask().
    void kill();
    /// Returns how the process ended, in words; nothing while it runs.
    [[nodiscard]] std::optional<std::string> end() const;

private:
    explicit Process(const SlotShape& shape) : shape_(shape) {}
    Result<void> share_memory(const Setup& setup);
    /// Reserves the slots' memory from the budget.
    Result<void> reserve(const Setup& setup);
    Result<void> greet(const Setup& setup, Channel control);
    /// Waits up to 1 s for the process to end. Returns how it ended, in words.
    std::string reap() const;

    const SlotShape shape_;
    Budget::Lease lease_;
    Fd memory_file_;
    Mapping memory_;
    pid_t pid_ = -1;
    std::optional<Channel> control_;  ///< set once started; closing it ends the worker
    std::vector<Channel> slots_;
    std::unique_ptr<Ready> ready_;
    std::set<std::string> given_;
};

}  // namespace raynest::server::device
