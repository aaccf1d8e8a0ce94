// Makes the boxes above moved instances and vertices anew, from the innermost objects to the root.
#pragma once

#include "engine/geometry/box.h"
#include "engine/math/vec.h"
#include "engine/scene/edits/deform.h"
#include "engine/scene/edits/edited_arena.h"
#include "engine/scene/tree_knowledge.h"

#include <cstdint>
#include <map>
#include <optional>
#include <span>
#include <vector>

namespace raynest {

/// An instance of an object whose box may change: it moves, or something in it does.
struct ChangedPlace {
    std::uint32_t place;                   ///< among the object's instances
    const Transform* to_parent = nullptr;  ///< where it moves to; null: it stays
};

struct ObjectChanges {
    std::vector<ChangedPlace> places;
    NewVertices vertices = {};  ///< empty: they stay
};

/// By object. What is above a changed place is changed itself, up to the root.
using ChangesByObject = std::map<std::uint32_t, ObjectChanges>;

struct Refitted {
    Box reached;  ///< where the root's changed instances were and are
    /// An instance whose box reaches beyond coordinate_max: the arena is spoilt.
    struct Far {
        std::uint32_t object;
        std::uint32_t place;
    };
    std::optional<Far> far;
    std::uint64_t nodes = 0;  ///< looked at
};

/// Moves and refits. The placements have been checked: they are invertible. Where few of an object's
/// many instances change, only the nodes above these are looked at. Brings what is known up to date;
/// `costs_before` are those of the trees as they are.
Refitted refit(EditedArena& arena, const ChangesByObject& changes,
               std::span<const double> costs_before, TreeKnowledge& known);

}  // namespace raynest
