// The answers of one side to a set of rays, and the differences between two sides.
#pragma once

#include "engine/geometry/hit.h"
#include "engine/packs/abi.h"
#include "tests/bench/files.h"

#include <cstddef>
#include <cstdint>
#include <functional>
#include <span>
#include <vector>

namespace raynest::bench {

struct Answers {
    Answers(Query of, std::uint32_t rays, std::uint32_t hits_per_ray)
        : query(of),
          hits_max(hits_per_ray),
          hits(std::size_t{rays} * hits_per_ray),
          counts(rays) {}

    /// The hits of a ray; for closest and any one record, which may be a miss.
    [[nodiscard]] std::span<const HitRecord> of(std::size_t ray) const {
        return {hits.data() + ray * hits_max, query == query_multi ? counts[ray] : 1};
    }

    Query query;
    std::uint32_t hits_max;
    std::vector<HitRecord> hits;
    std::vector<std::uint32_t> counts;  ///< multi only
};

/// Counted in rays. A mismatch is another hit or miss, another number of hits, or |dt| > 1e-4
/// (1 + t); a tie is the same t on another surface. What would be a mismatch but for the border of
/// a mask is counted apart.
struct Differences {
    std::uint64_t mismatches = 0;
    std::uint64_t ties = 0;
    std::uint64_t mask_borders = 0;
};
/// Does rounding decide whether this hit, the nearer one of two different answers, is a hole?
using AtMaskBorder = std::function<bool(std::size_t ray, const HitRecord& nearer)>;
Differences compare(const Answers& a, const Answers& b, const AtMaskBorder& at_mask_border = {});
/// Closest hits against a file; `inst` is compared where the file has one.
Differences compare(const Answers& a, std::span<const Reference> b);

/// Rays whose bytes differ: 0 among our own variants.
std::uint64_t count_unequal(const Answers& a, const Answers& b);

}  // namespace raynest::bench
