// Input at the limits of what is accepted, and rays that are not: it is answered
// like any other, on every traversal.
#pragma once

#include "tests/conformance/scenes.h"

#include <cstdint>
#include <string>
#include <vector>

namespace raynest::conformance {

struct BadInput {
    std::string name;
    std::uint32_t depth;
    SceneDescription scene;
    std::vector<Ray> rays;
};

/// Every way in which a ray is invalid, in every component.
std::vector<Ray> invalid_rays();

/// invalid-rays  each of them beside rays that hit, in one packet
/// no-area       triangles that are points and lines
/// coincident    1,000 copies of one triangle
/// needles       triangles 10^6 long, down to 10^-6 wide
/// far           triangles as large as the coordinates allow, and tiny ones that far out
/// far-placed    the same, reached by scaling up; and scaled down to a room's size
std::vector<BadInput> bad_inputs(std::uint32_t rays_each, Random& random);

}  // namespace raynest::conformance
