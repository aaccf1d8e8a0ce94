// Validates a device's hits before anything uses them: they hold indices into the scene's arrays.
#pragma once

#include "engine/geometry/views.h"
#include "engine/packs/abi.h"

namespace raynest::server::device {

enum class Answers {
    possible,
    given_up,   ///< the device gave up some rays because they took too long
    impossible  ///< no ray can have such hits in this scene
};

/// Checks that the call's hits and counts are in range for the scene, not that they are correct.
[[nodiscard]] Answers validate_hits(const TraceCall& call, const SceneView& scene, Query query);

}  // namespace raynest::server::device
