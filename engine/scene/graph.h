// The graph of objects and instances before any tree is built: what is reachable, in which order it
// can be built, and how often each leaf is placed.
#pragma once

#include "engine/result.h"
#include "engine/scene/description.h"

#include <cstdint>
#include <map>
#include <string>
#include <vector>

namespace raynest {

/// Numbers of placements below an object; all sums are checked for overflow.
struct Placements {
    std::uint64_t placement_count = 0;  ///< flat leaf placements (geometry/path.h)
    std::uint64_t triangles = 0;        ///< triangles in those leaves

    bool operator==(const Placements&) const = default;
};

/// An object that will be traced. Instance records are complete: `object` is an index into
/// Graph::objects, `path_base` is set, singular instances are left out.
struct GraphObject {
    std::uint32_t source = 0;  ///< index in the description
    std::uint32_t levels = 1;  ///< BVHs on the longest path down, itself included
    Placements traced;
    std::vector<InstanceRecord> instances;   ///< declaration order
    std::vector<std::uint32_t> declared_as;  ///< their indices in the description
};

struct Graph {
    std::vector<GraphObject> objects;  ///< reachable from the root, children first
    std::uint64_t declared_leaves =
        0;  ///< placements below the root, including those behind singular instances
    std::map<std::string, std::uint64_t> skipped;
    std::string singular;  ///< names a singular instance for a message; "" where there is none
};

/// Fails with scene_invalid or limit_exceeded and the object's name for an instance of no object, a
/// cycle, more than scene_depth_max levels, more than scene_paths_max paths. Iterative: no input
/// can exhaust the stack.
Result<Graph> resolve_graph(const SceneDescription& description);

/// Returns the name of an object for messages: its name in quotes, or its index.
std::string object_label(const SceneDescription& description, std::uint32_t object);

/// Returns the name of an object's instance for messages: the node of the file that placed it, else
/// its number and its object.
std::string instance_label(const SceneDescription& description, std::uint32_t object,
                           std::uint32_t instance);

/// Returns the number of the object's own triangles.
std::uint64_t own_triangles(const ObjectDescription& object);

}  // namespace raynest
