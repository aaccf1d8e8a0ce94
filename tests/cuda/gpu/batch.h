// Rays with room for their answers, in memory that the device reads and writes directly, and a way
// to send them through slots.
#pragma once

#include "engine/bvh/pages.h"
#include "tests/cuda/gpu/open_device.h"

#include <cstdint>
#include <span>
#include <string>

namespace raynest::bench {

/// A query to run for every ray.
struct Question {
    const char* name;
    Query query;
    std::uint32_t hits_max;
};
inline constexpr Question questions[] = {
    {"closest", query_closest, 1}, {"any", query_any, 1}, {"multi", query_multi, 8}};
inline constexpr std::uint32_t most_hits = 8;  ///< most hits per ray of any query

/// Rays and their answers. Pinned memory stays pinned: stop using the device once the batch is
/// destroyed.
class Batch {
public:
    /// Holds `count` rays: those of `from`, repeated or evenly sampled.
    Batch(std::span<const Ray> from, std::uint32_t count);
    /// Pins the memory. Returns the reason if that fails, else nothing.
    [[nodiscard]] std::string pin(const OpenDevice& device);

    [[nodiscard]] std::uint32_t count() const { return count_; }
    /// Returns a call for rays [first, first + count).
    [[nodiscard]] TraceCall call(const Question& question, std::uint32_t first,
                                 std::uint32_t count);
    /// Returns the part of a ray's answer that the query defines.
    [[nodiscard]] std::span<const HitRecord> answer(const Question& question,
                                                    std::uint32_t ray) const;
    void forget_answers();

private:
    std::uint32_t count_;
    Pages rays_, hits_, hit_counts_;
};

struct Pass {
    double wall_seconds;    ///< from the first copy's start to the last one's end
    double kernel_seconds;  ///< sum over the kernels
};

/// A way to trace a batch.
struct Route {
    const OpenDevice* device;
    const OpenDevice::Scene* scene;
    TraceFunction kernel;
    std::span<const OpenDevice::Slot> slots;  ///< in flight at once
    std::uint32_t chunk;                      ///< rays per slot
    const PinholeRays* made = nullptr;        ///< not null: the device makes the batch's rays
};

/// Runs a batch once; each slot is refilled in turn when its call is finished.
Pass run_pass(const Route& route, const Question& question, Batch& batch);

}  // namespace raynest::bench
