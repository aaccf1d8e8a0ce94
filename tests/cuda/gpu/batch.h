// Rays with room for their answers, in memory that the device reads and writes on its own, and a
// way to send them through slots.
#pragma once

#include "engine/bvh/pages.h"
#include "tests/cuda/gpu/open_device.h"

#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace raynest::bench {

/// What is asked of every ray.
struct Question {
    const char* name;
    Query query;
    std::uint32_t hits_max;
};
inline constexpr Question questions[] = {
    {"closest", query_closest, 1}, {"any", query_any, 1}, {"multi", query_multi, 8}};
inline constexpr std::uint32_t most_hits = 8;  ///< of a ray, in any question

/// Once pinned it stays so: use the device no more when it is gone.
class Batch {
public:
    /// `count` rays: those of `from` over and over, or an even share of more.
    Batch(std::span<const Ray> from, std::uint32_t count);
    /// Gives why it is not pinned, or nothing.
    [[nodiscard]] std::string pin(const OpenDevice& device);

    [[nodiscard]] std::uint32_t count() const { return count_; }
    /// Of rays [first, first + count).
    [[nodiscard]] TraceCall call(const Question& question, std::uint32_t first,
                                 std::uint32_t count);
    /// What the question defines of a ray's answer.
    [[nodiscard]] std::span<const HitRecord> answer(const Question& question,
                                                    std::uint32_t ray) const;
    void forget_answers();

private:
    std::uint32_t count_;
    Pages rays_, hits_, hit_counts_;
};

struct Pass {
    double wall_seconds;    ///< from the first copy's start to the last one's end
    double kernel_seconds;  ///< the kernels' own, added up
};

/// A way to answer a batch.
struct Route {
    const OpenDevice* device;
    const OpenDevice::Scene* scene;
    TraceFunction kernel;
    std::span<const OpenDevice::Slot> slots;  ///< in flight at once
    std::uint32_t chunk;                      ///< rays of a slot
    const PinholeRays* made = nullptr;        ///< not null: the device makes the batch's rays
};

/// Each slot is filled again when its call is finished, in turn.
Pass run_pass(const Route& route, const Question& question, Batch& batch);

}  // namespace raynest::bench
