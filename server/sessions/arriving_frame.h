// The memory of the frame that is on its way.
//
// Its buffer belongs to the connection: a request may end, by its deadline or an error, while the
// frame for it is half here, and a parked one has nothing reserved for it yet. So the connection
// holds the memory, shared with a job that has it reserved, from the header until the frame is
// handed on. What it holds counts for the rule of scheduling/peers.h.
#pragma once

#include "server/ground/budget.h"

#include <algorithm>
#include <cstdint>
#include <memory>
#include <utility>

namespace raynest::server {

/// Memory of a bulk part; empty: none is on its way. Io thread only.
class ArrivingFrame {
public:
    ArrivingFrame() = default;
    /// `memory` may be the job's, and is at least `bytes`.
    ArrivingFrame(std::shared_ptr<Budget::Lease> memory, std::uint64_t bytes)
        : memory_(std::move(memory)),
          bytes_(bytes) {}

    [[nodiscard]] bool is_covered() const { return memory_ != nullptr; }
    /// Bytes that no job counts as its own.
    [[nodiscard]] std::uint64_t held_bytes() const { return is_own() ? memory_->bytes() : 0; }
    /// Returns what the job of the frame had reserved besides, once it has ended.
    void settle() {
        if (is_own()) memory_->shrink(std::min(bytes_, memory_->bytes()));
    }

private:
    [[nodiscard]] bool is_own() const { return memory_.use_count() == 1; }

    std::shared_ptr<Budget::Lease> memory_;
    std::uint64_t bytes_ = 0;
};

}  // namespace raynest::server
