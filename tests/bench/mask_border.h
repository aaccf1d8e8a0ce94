// Where an alpha mask is decided by rounding.
//
// A mask with nearest texels is a step: at the border between a solid texel and a hole the last bit
// of u or v decides, and another way to compute them decides otherwise. That is no fault of either
// side as long as the hit lies that close to the border, which is computed here in double precision
// from the ray and the triangle, and from neither side's u and v.
#pragma once

#include "engine/geometry/hit.h"
#include "engine/geometry/ray.h"
#include "engine/geometry/views.h"

namespace raynest::bench {

/// Does the alpha test of the hit's surface answer both ways, solid and hole, to rays that pass
/// within two units in the last place of the largest coordinate beside `ray`? Only where they pass
/// through the triangle, so that its edges explain nothing here.
bool is_at_mask_border(const SceneView& scene, const Ray& ray, const HitRecord& hit);

}  // namespace raynest::bench
