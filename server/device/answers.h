// What a device brings back is looked at before anything reads through it: a number in a hit is an
// index into the scene.
#pragma once

#include "engine/geometry/views.h"
#include "engine/packs/abi.h"

namespace raynest::server::device {

/// Can these be answers to the call, whose `scene` is set? Says nothing about whether they are
/// right.
[[nodiscard]] bool are_possible(const TraceCall& call, Query query);

}  // namespace raynest::server::device
