// Embree's callbacks: the alpha test of our alpha_mask, and two ways to collect the N nearest hits,
// for which its API has no query.
#pragma once

#include "engine/geometry/hit.h"
#include "tests/bench/embree/api.h"

#include <cstdint>

namespace raynest::bench {

/// A query whose filter keeps a list. `nearest` is sorted by t.
struct ListAsker : Asker {
    using Asker::Asker;
    HitRecord* nearest = nullptr;
    std::uint32_t capacity = 0;
    std::uint32_t count = 0;
};

/// Rejects candidates whose alpha is below the cutoff. Any packet width.
void filter_alpha(const RTCFilterFunctionNArguments* call);

/// Lists every candidate and rejects it: the usual advice. Single rays, ListAsker only.
void filter_list_all(const RTCFilterFunctionNArguments* call);

/// As above, but once the list is full, accepts with tfar at the last distance of the list, so that
/// traversal ends there.
void filter_list_shrink(const RTCFilterFunctionNArguments* call);

}  // namespace raynest::bench
