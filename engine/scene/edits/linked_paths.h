// The tree of nodes that names the paths of a scene out of parts (FORMAT.md, sections 15 and 16).
#pragma once

#include "engine/result.h"
#include "engine/scene/content.h"
#include "engine/scene/edits/added_scene.h"
#include "engine/scene/edits/edit_guard.h"
#include "engine/scene/named_paths.h"
#include "engine/scene/snapshot.h"

#include <cstdint>
#include <span>

namespace raynest {

/// Copies of a scene behind the base's paths, one behind the other.
struct AddedPaths {
    const Snapshot* scene;
    std::uint32_t name;          ///< offset in content.names
    std::uint32_t first_number;  ///< the others count on; no_id: the only one, and unique
    std::uint32_t copies;
    std::uint32_t uid = no_id;  ///< all their nodes have this one; no_id: each keeps its own
};

/// Fills path_nodes and path_runs: the base's nodes without those that have lost all of their
/// placements, and a node for each copy, with the nodes of its scene below it; a scene without nodes
/// gets one for each instance on the way to a placement. Copies of scenes with one placement share a
/// node, and so do those of scenes without nodes and over named_placements_max placements, which are
/// numbered through. `kept`, paths of the base, is ascending. Nodes name the paths of the result
/// (nodes_name()). Fails once the guard stops.
Result<void> link_paths(const Snapshot& base, std::span<const PathRange> kept,
                        std::span<const AddedPaths> added, Content& content,
                        const EditGuard& guard = {});

/// Makes one node of neighbours that place leaves alone, if they have one name and user id, and their
/// numbers and paths follow each other: equal content has equal nodes, however it came about.
void join_nodes(Content& content);

/// Nodes that name the paths of a scene out of parts, at most.
inline constexpr std::uint64_t path_nodes_max = 1 << 24;

/// Placements of a scene without nodes that get nodes of their own: names cost memory.
inline constexpr std::uint64_t named_placements_max = 65536;

/// True if nodes name the paths of a base with these added scenes: it or one of them has nodes, and
/// it has no more than named_placements_max placements if it has none.
[[nodiscard]] bool nodes_name(const Snapshot& base, std::span<const AddedScene> added);

/// How many nodes each copy of a scene gets, but for copies that share one.
[[nodiscard]] std::uint64_t nodes_of_copy(const Snapshot& added);

/// True if one node stands for all placements of all copies.
[[nodiscard]] bool is_one_node(const Snapshot& added);

/// Returns the smallest number behind those of the outermost steps of this name, and no_id if there
/// is none of that name. Only where the base has nodes.
std::uint32_t next_number(const Snapshot& base, std::uint32_t name);

}  // namespace raynest
