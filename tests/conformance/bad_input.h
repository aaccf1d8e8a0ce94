// Input at the limits of what is accepted, and invalid rays: every traversal must answer both.
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

/// Returns rays that are invalid in every way, in every component.
std::vector<Ray> invalid_rays();

/// Returns these scenes with rays:
/// invalid-rays  invalid rays beside rays that hit, in one packet
/// no-area       triangles that are points and lines
/// coincident    1,000 copies of one triangle
/// needles       triangles 10^6 long, down to 10^-6 wide
/// far           triangles as large as the coordinates allow, and tiny ones at that distance
/// far-placed    the same, reached by scaling up; and scaled down to a room's size
std::vector<BadInput> bad_inputs(std::uint32_t rays_each, Random& random);

}  // namespace raynest::conformance
