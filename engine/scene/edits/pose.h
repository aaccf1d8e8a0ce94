// A scene at a moment of one of its animations.
#pragma once

#include "engine/result.h"
#include "engine/scene/edits/edit.h"
#include "engine/scene/motion/motion.h"
#include "engine/scene/snapshot.h"

#include <compare>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

namespace raynest {

/// An animation of a scene, as users see it.
struct SceneAnimation {
    std::string name;    ///< may be empty
    double seconds = 0;  ///< it runs from 0 to here
};
/// Returns the first `most` of a scene's animations.
[[nodiscard]] std::vector<SceneAnimation> animations_of(const Snapshot& scene,
                                                        std::size_t most = motion_animations_max);

struct Moment {
    std::uint32_t animation = 0;  ///< its index
    double seconds = 0;

    auto operator<=>(const Moment&) const = default;
};

/// Returns the moment `seconds` of the animation of this name or number, the first one where it is
/// empty. Fails with field_invalid and what there is instead: an unknown animation, a time outside
/// it, a scene that does not move. Reads no name beyond the length of the one that is sought.
Result<Moment> find_moment(const Snapshot& scene, std::string_view animation, double seconds);

/// Returns the bytes that pose() takes while it runs, besides a copy of the scene. Looks at all
/// that moves.
std::uint64_t bytes_to_pose(const Snapshot& scene);

/// Returns the scene at a moment that it has. Nodes that the animation does not move are where the
/// scene was loaded with them. Edits apply to an instance after the animation has placed it: what has
/// moved it from its loaded place then moves it. Keys are met exactly; what lies between is computed
/// in double. An instance whose scale becomes 0 is hidden. Rays hit what they would hit in a scene
/// loaded in this pose, bit for bit. Costs what edit_scene() costs, and the vertices that move. Asks
/// the guard for all of that. Thread-safe. Fails as edit_scene() does. Throws std::bad_alloc.
Result<std::shared_ptr<const Snapshot>> pose(const Snapshot& scene, const Moment& moment,
                                             const EditGuard& guard = {});

}  // namespace raynest
