// The rays or points that a client sends for a query, kept until they are answered.
#pragma once

#include "engine/geometry/ray.h"
#include "protocol/control.h"
#include "protocol/frame.h"
#include "protocol/wire.h"
#include "server/execution/trace.h"
#include "server/ground/budget.h"
#include "server/ground/errors.h"

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <mutex>
#include <span>
#include <vector>

namespace raynest::server {

/// Rays as a client sends them: whole, or only the vectors in which the rays of a frame differ.
class SentRays {
public:
    SentRays() = default;
    /// Reads the rays of a frame, which must outlive the result. Fails with INVALID_FIELD if the
    /// frame lacks a value that its rays need, has one that each of its rays has too, or has not
    /// one mask for each ray or none.
    static Reply<SentRays> of(const protocol::Opened<wire::QueryRays>& message);

    [[nodiscard]] bool empty() const { return count() == 0; }
    [[nodiscard]] std::uint64_t count() const { return bytes_.size() / stride_; }
    /// True if the frame holds whole rays.
    [[nodiscard]] bool are_whole() const { return stride_ == sizeof(Ray); }
    /// Returns rays [first, first + count) in place; they must be whole.
    [[nodiscard]] std::span<const Ray> whole(std::uint64_t first, std::uint64_t count) const;
    /// Writes rays [first, first + out.size()) to `out` as whole rays.
    void widen(std::uint64_t first, std::span<Ray> out) const;
    /// The mask of each ray; empty: none has one of its own.
    [[nodiscard]] std::span<const std::uint32_t> masks() const { return masks_; }

private:
    std::span<const std::byte> bytes_;
    std::span<const std::uint32_t> masks_;
    std::uint32_t stride_ = sizeof(Ray);
    Ray common_;  ///< the members that all rays of the frame share
};

/// Keeps each frame until the last of its rays is answered. Call feed() on the io thread, the rest
/// on any thread.
class RayInput {
public:
    /// `sent` is the number of rays that the client sends, or of points with `rays_each` rays each.
    /// Their memory is charged to `principal`.
    RayInput(std::uint64_t sent, std::uint64_t rays_each, const protocol::Limits& limits,
             Budget& budget, std::string principal)
        : sent_(sent),
          rays_each_(rays_each),
          limits_(limits),
          budget_(budget),
          principal_(std::move(principal)) {}

    /// Takes a QUERY_RAYS frame. Returns the number of the query's rays that come from it.
    Reply<std::uint64_t> feed(protocol::Frame frame);
    [[nodiscard]] bool complete() const { return received_ == sent_; }
    /// True if rays of the frames so far have masks of their own.
    [[nodiscard]] bool has_masks() const { return has_masks_; }
    /// Number of the query's rays that come from the frames so far.
    [[nodiscard]] std::uint64_t received_rays() const { return received_ * rays_each_; }

    /// Returns sent rays or points [first, first + count): in place if possible, else copied to
    /// buffers.sent. They are valid until release().
    [[nodiscard]] std::span<const Ray> sent(std::uint64_t first, std::uint64_t count,
                                            TraceBuffers& buffers);
    /// Returns the masks of rays [first, first + count) of the query, in buffers.masks; nothing if
    /// no frame so far has any. Fails with LIMIT_EXCEEDED where that makes more than ray_masks_max
    /// of them differ.
    Reply<std::span<const std::uint32_t>> masks(std::uint64_t first, std::uint64_t count,
                                                TraceBuffers& buffers);
    /// Marks rays [first, first + count) of the query as answered; frees frames without others.
    void release(std::uint64_t first, std::uint64_t count);
    /// Returns the bulk bytes of frames freed since the last call.
    [[nodiscard]] std::uint64_t take_freed() { return freed_bytes_.exchange(0); }

private:
    struct Received {
        std::uint64_t first;  ///< index of its first ray or point among those sent
        SentRays sent;
        protocol::Buffer bulk;
        Budget::Lease lease;       ///< for the memory besides `bulk`
        std::uint64_t unanswered;  ///< number of rays
    };
    /// Returns the frame that holds the sent ray or point `first`. Requires the lock.
    [[nodiscard]] Received& frame_of(std::uint64_t first);
    /// Fails if too many of all masks so far differ.
    Reply<void> count_masks(std::span<const std::uint32_t> masks);

    const std::uint64_t sent_;
    const std::uint64_t rays_each_;
    const protocol::Limits& limits_;
    Budget& budget_;
    const std::string principal_;
    std::uint64_t received_ = 0;
    std::atomic<std::uint64_t> freed_bytes_{0};
    std::atomic<bool> has_masks_{false};
    std::mutex mutex_;
    std::vector<std::uint32_t> different_masks_;  ///< masks of the rays asked for so far
    std::deque<Received> frames_;                 ///< in order; the front one has unanswered rays
};

}  // namespace raynest::server
