// Finds equal subtrees of a glTF scene, to recover nesting deeper than mesh-in-scene.
//
// glTF gives every node one parent, so exporters write a tree a thousand times if it is placed a
// thousand times. Two subtrees are equal if they place the same meshes with the same transforms
// relative to their top and with the same masks; names do not matter. Numbering the distinct ones
// from the leaves up (hash-consing) finds them all in one pass. A subtree becomes an object if that
// pays: it is used at least twice and holds at least two placements. A subtree that would nest too
// deep is not shared, but its parts are.
#pragma once

#include "engine/assets/gltf/file/model.h"
#include "engine/assets/gltf/masks.h"

#include <cstdint>
#include <vector>

namespace raynest::gltf {

/// Levels of a scene from a glTF file, its root and its meshes included: as many as a GPU accepts,
/// and far fewer than scene_depth_max.
inline constexpr std::uint32_t gltf_levels_max = 8;

/// One distinct subtree, without the transform of its top node.
struct Shape {
    std::uint64_t placements = 0;  ///< number of mesh placements
    std::uint32_t uses = 0;        ///< uses by distinct shapes and by the scene
    std::uint32_t levels = 0;      ///< object levels below an object of this shape
    std::uint32_t example = 0;     ///< the first node of this shape in depth-first order
    /// Holds a skinned mesh, or a node that an animation moves: not shared.
    bool in_scene_space = false;

    [[nodiscard]] bool is_shared() const {
        return !in_scene_space && uses >= 2 && placements >= 2 && levels + 2 <= gltf_levels_max;
    }
};

struct Sharing {
    std::vector<Shape> shapes;            ///< children first
    std::vector<std::uint32_t> shape_of;  ///< by node; no_id if it places nothing
};

/// Finds the distinct subtrees. `order` lists the nodes of the scene, parents before children;
/// `traceable` marks meshes that have triangles. Iterative and linear in nodes plus the text of
/// their keys.
Sharing find_sharing(const Model& model, const std::vector<std::uint32_t>& order,
                     const std::vector<bool>& traceable, const Masks& masks);

}  // namespace raynest::gltf
