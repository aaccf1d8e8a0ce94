// What a device brings back is looked at before anything reads through it: a number in a hit is an
// index into the scene.
#pragma once

#include "engine/geometry/views.h"
#include "engine/packs/abi.h"

namespace raynest::server::device {

/// Can the call's hits and counts be answers about the scene? Says nothing about whether they are
/// right.
[[nodiscard]] bool are_possible(const TraceCall& call, const SceneView& scene, Query query);

}  // namespace raynest::server::device
