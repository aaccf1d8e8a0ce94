// A scene to measure: as described (what a peer is built from), built, and with a light where the
// scene has one.
#pragma once

#include "engine/packs/registry.h"
#include "engine/result.h"
#include "engine/scene/snapshot.h"
#include "tests/bench/generators.h"

#include <memory>
#include <optional>
#include <string>

namespace raynest::bench {

struct Workload {
    std::string name;
    SceneDescription description;
    std::shared_ptr<const Snapshot> scene;
    std::optional<Light> light;
};

/// `gen:...`, `builtin:...`, a glTF file, a `.soup` or an `.inst` file.
Result<Workload> load_workload(const std::string& source, const Registry& registry);

}  // namespace raynest::bench
