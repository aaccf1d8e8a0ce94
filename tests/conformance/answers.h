// A kernel's answers to a list of rays, and how two answers differ.
#pragma once

#include "engine/packs/registry.h"

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

namespace raynest::conformance {

/// A query to run for every ray.
struct Question {
    Query query;
    std::uint32_t hits_max;
};

/// The small budget of `all` stops many rays early, the large one none.
inline constexpr Question questions[] = {
    {query_closest, 1}, {query_any, 1}, {query_multi, 8}, {query_all, 3}, {query_all, 4096}};

struct Answer {
    std::vector<HitRecord> hits;
    std::vector<std::size_t> first;  ///< index of each ray's first hit
    std::vector<std::uint32_t> counts;
    std::vector<std::uint8_t> ray_flags;  ///< set by `all`
    std::vector<Counters> counters;
    std::vector<std::vector<std::uint32_t>> outputs;

    /// Returns the records that the query defines: for `multi` and `all` the filled part, else one
    /// record, which may be a miss.
    [[nodiscard]] std::span<const HitRecord> of(std::size_t ray) const {
        return {hits.data() + first[ray], counts[ray]};
    }
};

/// Runs a query. Throws std::runtime_error if the kernel refuses the call, which is well formed.
Answer ask(const Variant& variant, TraceFunction function, const SceneView& scene,
           std::span<const Ray> rays, const Question& question, const Settings& settings,
           CounterMode counters = counters_total);

bool same_bytes(std::span<const HitRecord> a, std::span<const HitRecord> b);

struct Difference {
    std::uint64_t rays = 0;
    std::size_t first = 0;  ///< index of the first such ray
};

/// Compares the outputs of rays whose search nothing cut short: they have met every candidate.
/// Returns how many were not 0; nothing if one differs.
std::optional<std::uint64_t> compare_outputs(const Answer& a, const Answer& b,
                                             const Question& question);

/// Returns the rays whose answers differ in any byte.
Difference differing_rays(const Answer& a, const Answer& b);

}  // namespace raynest::conformance
