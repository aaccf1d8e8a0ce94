// Notes of a lit picture or path about its light.
#pragma once

#include "engine/integrators/integrator.h"
#include "engine/scene/snapshot.h"
#include "protocol/limits.h"

#include <string>
#include <vector>

namespace raynest::server {

/// Returns what the integrator chose, and a warning where coordinates are too large for light.
[[nodiscard]] std::vector<std::string> light_notes(const Integrator& integrator,
                                                   const Snapshot& scene,
                                                   const protocol::Limits& limits);

}  // namespace raynest::server
