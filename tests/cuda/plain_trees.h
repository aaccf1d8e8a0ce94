// The plain twin of cuda/device_tree.h: the same walk over the CPU's own nodes and blocks, one slot
// and one triangle after the other. What differs between the two is the fault of the compressed
// form.
#pragma once

#include "engine/bvh/ask.h"
#include "engine/bvh/box_test.h"
#include "engine/bvh/node.h"
#include "engine/geometry/intersect_triangle.h"
#include "engine/geometry/views.h"

#include <cstdint>

namespace raynest::cuda {

struct PlainTrees {
    const SceneView* scene;

    struct Tree {
        const Node* nodes;
        const TriangleBlock* blocks;

        [[nodiscard]] std::uint32_t child(std::uint32_t node, std::uint32_t slot) const {
            return nodes[node].child[slot];
        }
        template <class Isect>
        [[nodiscard]] std::uint32_t entered(std::uint32_t node, const BoxRay& ray,
                                            std::uint32_t octant, Isect& isect) const {
            std::uint32_t mask = 0;
            for (std::uint32_t slot = 0; slot < 8; ++slot) {
                if ((nodes[node].valid() >> slot & 1U) == 0) continue;
                const Box box = Boxes8{&nodes[node]}.box_of(static_cast<int>(slot));
                mask |= ask(isect, ray, BoxRef{&box}).mask << (slot ^ octant);
            }
            return mask;
        }
        template <class Visitor>
        [[nodiscard]] bool visit_triangles(std::uint32_t leaf, Visitor&& visitor) const {
            const TriangleBlock* const first = blocks + leaf_first(leaf);
            for (const TriangleBlock* at = first; at != first + leaf_count(leaf); ++at) {
                for (int lane = 0; lane < 8; ++lane) {
                    if (at->triangle[lane] != no_id && visitor(TriangleRef(*at, lane))) return true;
                }
            }
            return false;
        }
    };
    [[nodiscard]] Tree of(const ObjectRecord& object) const {
        return {scene->nodes + object.first_node, scene->blocks + object.first_block};
    }
};

}  // namespace raynest::cuda
