// JSON documents: the only header of the server that includes the library.
#pragma once

#include "engine/geometry/box.h"
#include "engine/geometry/hit.h"
#include "engine/scene/snapshot.h"

#include <nlohmann/json.hpp>

#include <string>

namespace raynest::server {

/// Keys stay in the order in which they were added.
using Json = nlohmann::ordered_json;

/// Returns the number with as few digits as tell the float; null if it is not finite.
[[nodiscard]] Json number(float value);
/// Returns a point of the scene in the world, [x, y, z].
[[nodiscard]] Json world_point(const Vec3& point, const WorldPoint& origin);
/// Returns a box in the world, [[x, y, z], [x, y, z]]; null if it is empty.
[[nodiscard]] Json world_box(const Box& box, const WorldPoint& origin);
/// Returns every counter of a ray or level by its name, sums included.
[[nodiscard]] Json counters_json(const Counters& counters);
/// Returns the document's text; invalid UTF-8 is replaced.
[[nodiscard]] std::string text_of(const Json& document);

}  // namespace raynest::server
