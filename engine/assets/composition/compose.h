// Scenes out of files: *.rnscene.json names objects and says where they stand.
//
//   text ──read()──► Composition ──each file, group by group──► snapshots ──link_scenes()──► arena
//
// A file that several objects name is read once for each way to read it, and a file that names
// others of its own finds them beside itself.
#pragma once

#include "engine/assets/input/import_request.h"
#include "engine/result.h"
#include "engine/scene/snapshot.h"

#include <cstdint>
#include <functional>
#include <string_view>

namespace raynest {

/// Compositions within compositions, the outermost one counted: as deep as scenes nest.
inline constexpr std::uint32_t compositions_nested_max = 8;

[[nodiscard]] bool is_composition(std::string_view source);

/// Imports one file of a composition, which is none itself.
using ImportFile = std::function<Result<BuiltArena>(const ImportRequest&)>;

/// Reads a composition, imports its files and puts them together. Cameras and lights of an object
/// come along where it stands at one place; animations do not. Errors name the object and the file.
/// scene_invalid: as composition::read(), a file that is not there, a composition that holds itself
/// or an object that does. limit_exceeded: over nodes_max named nodes, and as link_scenes().
Result<BuiltArena> compose(const ImportRequest& request, const ImportLimits& limits,
                           const ImportFile& import_file);

}  // namespace raynest
