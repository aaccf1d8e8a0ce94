// Chooses the importer for a source, and imports files into a snapshot arena without a child
// process.
#pragma once

#include "engine/assets/input/import_request.h"
#include "engine/packs/registry.h"
#include "engine/result.h"
#include "engine/scene/snapshot.h"

#include <memory>
#include <string_view>

namespace raynest {

/// Describes a source that is no file: "builtin:forest". Who imports chooses which scenes there are,
/// as describe_builtin() (builtin/builtin.h); null: none.
using DescribeBuiltin = Result<SceneDescription> (*)(std::string_view source);

/// Parses, validates and describes; builds no trees. Opens no file outside `request.files`.
Result<SceneDescription> describe(const ImportRequest& request, const ImportLimits& limits,
                                  const Registry& registry, DescribeBuiltin builtin = nullptr);

/// Runs describe() and build_arena() in this process.
Result<BuiltArena> import_arena(const ImportRequest& request, const ImportLimits& limits,
                                const Registry& registry, DescribeBuiltin builtin = nullptr);

/// Runs import_arena() and Snapshot::open(). For embedders that trust their files, and for tests.
Result<std::shared_ptr<const Snapshot>> import_here(const ImportRequest& request,
                                                    const ImportLimits& limits,
                                                    const Registry& registry,
                                                    DescribeBuiltin builtin = nullptr);

}  // namespace raynest
