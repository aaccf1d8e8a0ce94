// `--integrator direct`: paths of one bounce. All lights, shadows and the surroundings, but no
// light that other surfaces send on.
#pragma once

#include "engine/integrators/path.h"

namespace raynest {

class Direct final : public Path {
public:
    Direct(const IntegratorScene& scene, const IntegratorSettings& settings)
        : Path(scene, settings, 1) {}
};

}  // namespace raynest
