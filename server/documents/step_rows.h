// Answers of rays that were traced step by step (execution/step_order.h), put in the order of rays.
#pragma once

#include "protocol/control.h"
#include "server/documents/columns.h"
#include "server/execution/step_order.h"
#include "server/ground/budget.h"
#include "server/scheduling/job.h"

#include <atomic>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

namespace raynest::server {

/// Keeps the rows of a scan until all have come, then hands them out.
class StepRows {
public:
    /// The size of a frame that is handed out, at most.
    struct FrameSize {
        std::uint64_t rays = 0;
        std::uint64_t bytes = 0;  ///< the columns'; at least those of one ray
    };

    StepRows(Budget& budget, std::string principal, std::uint64_t id, const Columns::Cost& cost,
             const FrameSize& most)
        : budget_(budget),
          principal_(std::move(principal)),
          id_(id),
          cost_(cost),
          most_(most) {}

    /// Adds a CHUNK whose rows are of places from its first_ray on. Fails with RESOURCE_EXHAUSTED.
    /// Any thread.
    Reply<void> add(const StepOrder& order, protocol::Frame frame);
    /// Returns a task that makes the next frame; nothing while one runs or no scan is complete. Io
    /// thread.
    std::optional<Task> next(const StepOrder& order);
    /// Called when a task has ended. Io thread.
    void ended();
    /// Rows that frames have. Any thread.
    [[nodiscard]] std::uint64_t handed_out() const { return handed_out_; }

private:
    /// Rows of places that follow each other.
    struct KeptChunk {
        protocol::Frame frame;
        Budget::Lease lease;
        protocol::Opened<wire::Chunk> chunk;
        std::span<const std::uint64_t> splits;  ///< empty unless the number of hits varies
    };
    struct Scan {
        std::uint64_t arrived = 0;
        std::vector<std::unique_ptr<KeptChunk>> chunks;
    };
    /// Rows [first, first + count) of a kept.
    struct Part {
        const KeptChunk* kept;
        std::uint64_t first, count;
        [[nodiscard]] std::uint64_t hits_begin() const;
        [[nodiscard]] std::uint64_t hits() const;
    };

    Reply<Frames> make_frame(const StepOrder& order);
    /// The rows of the next frame: those of one scan, as many as fit.
    [[nodiscard]] std::vector<Part> next_parts(const StepOrder& order) const;

    Budget& budget_;
    const std::string principal_;
    const std::uint64_t id_;
    const Columns::Cost cost_;
    const FrameSize most_;
    std::mutex mutex_;
    std::vector<Scan> scans_;
    // These are of the scan that is handed out; used by the io thread, or by the one task.
    std::size_t scan_ = 0;
    bool is_sorted_ = false;
    std::atomic<std::uint64_t> handed_out_ = 0;
    enum class Turn { io, runs, ran };
    std::atomic<Turn> turn_ = Turn::io;
};

}  // namespace raynest::server
