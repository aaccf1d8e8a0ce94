// What a kernel answers to a list of rays, and how two answers differ.
#pragma once

#include "engine/packs/registry.h"

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace raynest::conformance {

/// What is asked of every ray.
struct Question {
    Query query;
    std::uint32_t hits_max;
};

/// The small budget of `all` cuts many rays short, the large one none.
inline constexpr Question questions[] = {
    {query_closest, 1}, {query_any, 1}, {query_multi, 8}, {query_all, 3}, {query_all, 4096}};

struct Answer {
    std::vector<HitRecord> hits;
    std::vector<std::size_t> first;  ///< of each ray's hits
    std::vector<std::uint32_t> counts;
    std::vector<std::uint8_t> ray_flags;  ///< of `all`
    std::vector<Counters> counters;
    std::vector<std::vector<std::uint32_t>> outputs;

    /// What the query defines: of `multi` and `all` the filled part, else one record, which may be
    /// a miss.
    [[nodiscard]] std::span<const HitRecord> of(std::size_t ray) const {
        return {hits.data() + first[ray], counts[ray]};
    }
};

/// Throws std::runtime_error where the kernel refuses, which is a fault: the call is well formed.
Answer ask(const Variant& variant, TraceFunction function, const SceneView& scene,
           std::span<const Ray> rays, const Question& question, const Settings& settings);

bool same_bytes(std::span<const HitRecord> a, std::span<const HitRecord> b);

struct Difference {
    std::uint64_t rays = 0;
    std::size_t first = 0;  ///< index of the first of them
};

/// Rays whose answers differ in any byte.
Difference differing_rays(const Answer& a, const Answer& b);

}  // namespace raynest::conformance
