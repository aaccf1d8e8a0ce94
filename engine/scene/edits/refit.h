// Makes the boxes above moved instances anew, from the innermost objects to the root.
#pragma once

#include "engine/geometry/box.h"
#include "engine/math/vec.h"
#include "engine/scene/edits/edited_arena.h"

#include <cstdint>
#include <map>
#include <optional>
#include <vector>

namespace raynest {

/// An instance of an object whose box may change: it moves, or something in it does.
struct ChangedPlace {
    std::uint32_t place;                   ///< among the object's instances
    const Transform* to_parent = nullptr;  ///< where it moves to; null: it stays
};

/// Changed places by object. What is above a changed place is changed itself, up to the root.
using ChangedPlaces = std::map<std::uint32_t, std::vector<ChangedPlace>>;

struct Refitted {
    Box reached;  ///< where the root's changed instances were and are
    /// An instance whose box reaches beyond coordinate_max: the arena is spoilt.
    struct Far {
        std::uint32_t object;
        std::uint32_t place;
    };
    std::optional<Far> far;
};

/// Moves and refits. The placements have been checked: they are invertible.
Refitted refit(EditedArena& arena, const ChangedPlaces& places);

}  // namespace raynest
