// What raynest-bench-cuda does with one scene and one file of rays. Rows are JSON objects, one per
// variant and question.
#pragma once

#include "engine/geometry/pinhole.h"
#include "engine/geometry/ray.h"
#include "engine/geometry/views.h"
#include "tests/cuda/gpu/open_device.h"

#include <nlohmann/json_fwd.hpp>

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

namespace raynest::bench {

struct Work {
    const SceneView& scene;
    const std::vector<Ray>& rays;
    std::uint32_t count;      ///< rays of a pass (Batch says which)
    std::uint32_t chunk;      ///< rays of a slot, in check()
    const PinholeRays* made;  ///< not null: `rays` are these, and in check() the device makes them
    std::function<void(nlohmann::ordered_json)> print;
};

/// Every variant of the device against the CPU's: rays that differ in any byte of their answer.
/// False where one does.
bool check(const OpenDevice& device, const Pack& cpu, const Work& work);

/// Million rays per second, as the median of `rounds`, in which all ways of a question take turns:
///   kernel   all rays in one call, by the device's clock, without copies
///   pinned   pinned rays to pinned answers, 2^14 or 2^17 rays per slot, 1, 2 and 4 slots in flight
///   bus      the same through a scene of nothing: what copying alone allows
/// Where memory cannot be pinned, rows of both functions say why in `not_pinned`, and these are not
/// compared with what is possible.
void time(const OpenDevice& device, const Work& work, std::uint32_t rounds);

}  // namespace raynest::bench
