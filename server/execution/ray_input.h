// The rays, or points, that a client sends for a query, from their frames to their answers.
#pragma once

#include "engine/geometry/ray.h"
#include "protocol/control.h"
#include "protocol/frame.h"
#include "protocol/wire.h"
#include "server/errors.h"
#include "server/execution/trace.h"
#include "server/store/budget.h"

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <mutex>
#include <span>
#include <vector>

namespace raynest::server {

/// Rays as a client sends them: whole ones, or only what those of a frame do not have in common.
class SentRays {
public:
    SentRays() = default;
    /// Those of a frame, which must outlive it. INVALID_FIELD where it lacks what they need, or
    /// says of all what each ray brings.
    static Reply<SentRays> of(const protocol::Opened<wire::QueryRays>& message);

    [[nodiscard]] bool empty() const { return count() == 0; }
    [[nodiscard]] std::uint64_t count() const { return bytes_.size() / stride_; }
    /// Do they lie there as whole rays?
    [[nodiscard]] bool are_whole() const { return stride_ == sizeof(Ray); }
    /// The whole rays [first, first + count), where they lie.
    [[nodiscard]] std::span<const Ray> whole(std::uint64_t first, std::uint64_t count) const;
    /// Writes rays [first, first + out.size()).
    void widen(std::uint64_t first, std::span<Ray> out) const;

private:
    std::span<const std::byte> bytes_;
    std::uint32_t stride_ = sizeof(Ray);
    Ray common_;  ///< what shorter rays do not bring
};

/// Keeps each frame until the last of its rays is answered. feed() on the io thread, the rest on
/// any.
class RayInput {
public:
    /// `sent`: rays, or points of `rays_each` rays, that the client sends.
    RayInput(std::uint64_t sent, std::uint64_t rays_each, const protocol::Limits& limits,
             Budget& budget)
        : sent_(sent),
          rays_each_(rays_each),
          limits_(limits),
          budget_(budget) {}

    /// Takes a QUERY_RAYS frame, and gives how many rays of the query it holds, or makes.
    Reply<std::uint64_t> feed(protocol::Frame frame);
    [[nodiscard]] bool complete() const { return received_ == sent_; }
    /// Rays that the frames so far hold, or make.
    [[nodiscard]] std::uint64_t received_rays() const { return received_ * rays_each_; }

    /// The sent rays, or points, [first, first + count): where they lie, else in buffers.sent. They
    /// stay until release().
    [[nodiscard]] std::span<const Ray> sent(std::uint64_t first, std::uint64_t count,
                                            TraceBuffers& buffers);
    /// Rays [first, first + count) of the query are answered.
    void release(std::uint64_t first, std::uint64_t count);
    /// Bulk bytes of frames that were released since the last call.
    [[nodiscard]] std::uint64_t take_freed() { return freed_bytes_.exchange(0); }

private:
    struct Received {
        std::uint64_t first;  ///< in the query: of what was sent
        SentRays sent;
        protocol::Buffer bulk;
        Budget::Lease lease;       ///< of what it costs beside its bulk
        std::uint64_t unanswered;  ///< rays
    };
    /// The frame that holds what was sent as number `first`; under the lock.
    [[nodiscard]] Received& frame_of(std::uint64_t first);

    const std::uint64_t sent_;
    const std::uint64_t rays_each_;
    const protocol::Limits& limits_;
    Budget& budget_;
    std::uint64_t received_ = 0;
    std::atomic<std::uint64_t> freed_bytes_{0};
    std::mutex mutex_;
    std::deque<Received> frames_;  ///< in order, from the first one that is not answered on
};

}  // namespace raynest::server
