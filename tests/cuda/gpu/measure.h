// Measurements of raynest-bench-cuda with one scene and one file of rays. Rows are JSON objects,
// one per variant and query.
#pragma once

#include "engine/geometry/pinhole.h"
#include "engine/geometry/ray.h"
#include "engine/geometry/views.h"
#include "tests/cuda/gpu/open_device.h"

#include <nlohmann/json_fwd.hpp>

#include <cstdint>
#include <functional>
#include <vector>

namespace raynest::bench {

struct Work {
    const SceneView& scene;
    const std::vector<Ray>& rays;
    std::uint32_t count;      ///< rays per pass (Batch says which)
    std::uint32_t chunk;      ///< rays per slot, in check()
    const PinholeRays* made;  ///< not null: source of `rays`; in check() the device makes them
    std::function<void(nlohmann::ordered_json)> print;
};

/// Compares every variant of the device with the CPU's: prints the rays that differ in any byte of
/// their answer. Returns false if one does.
bool check(const OpenDevice& device, const Pack& cpu, const Work& work);

/// Prints million rays per second, as the median of `rounds`, in which all ways of a query take
/// turns:
///   kernel   all rays in one call, by the device's clock, without copies
///   pinned   pinned rays to pinned answers, 2^14 or 2^17 rays per slot, 1, 2 and 4 slots in flight
///   bus      the same through an empty scene: the limit set by copying
/// If memory cannot be pinned, the rows of both functions give the reason in `not_pinned`, and have
/// no comparison with that limit.
void time(const OpenDevice& device, const Work& work, std::uint32_t rounds);

}  // namespace raynest::bench
