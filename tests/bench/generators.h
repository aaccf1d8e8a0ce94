// The scenes that are measured: one of each class on which ray tracers behave differently.
//
//   terrain       height field and tessellated spheres, 2 M triangles
//   cards         randomly turned alpha-masked quads, 0.4 M triangles
//   forest1       10 k trees in one level of instances on a ground mesh, 10 M triangles placed
//   forest3       stands of trees of branches: three levels, 100 k leaf placements, 100 M triangles
//   forest3-flat  the same leaf placements in the same order, in one level
//   interior      a closed, rotated room with long thin triangles, 2.4 M triangles
#pragma once

#include "engine/result.h"
#include "engine/scene/description.h"

#include <optional>
#include <string>

namespace raynest::bench {

/// A rectangle that shines: shadow rays end on it.
struct Light {
    Vec3 corner;
    Vec3 edge[2];
};

struct Generated {
    SceneDescription scene;
    std::optional<Light> light;
};

/// `gen:NAME[?scale=S]`: the same source gives the same bytes. S in (0, 4] multiplies the number of
/// triangles (of placements, in forests) and keeps what a ray meets about the same.
Result<Generated> generate(const std::string& source);

}  // namespace raynest::bench
