// What a device brings back is looked at before anything reads through it: a number in a hit is an
// index into the scene.
#pragma once

#include "engine/geometry/views.h"
#include "engine/packs/abi.h"

namespace raynest::server::device {

enum class Answers {
    possible,
    given_up,   ///< some rays have none, because they took too long
    impossible  ///< no rays of this scene have such
};

/// What the call's hits and counts are, as answers about the scene. Says nothing about whether they
/// are right.
[[nodiscard]] Answers validate_hits(const TraceCall& call, const SceneView& scene, Query query);

}  // namespace raynest::server::device
