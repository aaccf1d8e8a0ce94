// Scenes that become parts of others.
#pragma once

#include "engine/math/vec.h"
#include "engine/scene/snapshot.h"

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace raynest {

/// A scene that becomes part of another one: its geometry and materials, without its cameras and
/// lights. Each placement is an outermost instance from then on.
struct AddedScene {
    std::shared_ptr<const Snapshot> scene;
    /// Their step in path texts, as path_step_text() spells it. Where it is there already, or has
    /// several placements, they have numbers behind it, counted on from the largest.
    std::string name;
    std::vector<Transform> to_scene;
    std::vector<std::uint32_t> masks;  ///< one for each
    std::uint32_t uid = no_id;         ///< user id of all placements; no_id: none
    bool is_numbered = false;          ///< a number even where there is only one placement
};

}  // namespace raynest
