// The colour that a surface has by itself: what the picture `primary` and the column base_colour
// show.
#pragma once

#include "engine/geometry/hit.h"
#include "engine/geometry/views.h"
#include "engine/math/vec.h"

namespace raynest {

/// Returns baseColorFactor x baseColorTexture x COLOR_0 of a hit, linear; white by default.
/// Textures are looked up at their full size, filtered like alpha (intersectors/texture.h).
[[nodiscard]] Vec3 base_colour(const SceneView& scene, const HitRecord& hit);

}  // namespace raynest
