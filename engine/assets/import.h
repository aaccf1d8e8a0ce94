// Chooses the importer for a source, and imports files into a snapshot arena without a child
// process.
#pragma once

#include "engine/assets/input/import_request.h"
#include "engine/packs/registry.h"
#include "engine/result.h"
#include "engine/scene/snapshot.h"

#include <memory>

namespace raynest {

/// Parses, validates and describes; builds no trees. Opens no file outside `request.files`.
Result<SceneDescription> describe(const ImportRequest& request, const ImportLimits& limits,
                                  const Registry& registry);

/// Runs describe() and build_arena() in this process.
Result<BuiltArena> import_arena(const ImportRequest& request, const ImportLimits& limits,
                                const Registry& registry);

/// Runs import_arena() and Snapshot::open(). For embedders that trust their files, and for tests.
Result<std::shared_ptr<const Snapshot>> import_here(const ImportRequest& request,
                                                    const ImportLimits& limits,
                                                    const Registry& registry);

}  // namespace raynest
