// A plain version of cuda/device_tree.h: binary nodes, which hold both children's boxes in full
// precision, over the CPU's own leaves. The same traversal runs on another layout and topology: if
// the answers differ, one of the two is wrong.
//
// A node of the CPU's tree becomes up to seven: its children are split in halves, three deep, along
// the axis on which their centres are spread most. The first of the seven keeps the number of the
// wide node, and the others follow all of those. So ObjectRecord::root and child words (bvh/node.h)
// stay valid.
#pragma once

#include "engine/bvh/box_test.h"
#include "engine/bvh/intersect_with.h"
#include "engine/bvh/node.h"
#include "engine/cuda/device_tree.h"
#include "engine/geometry/intersect_triangle.h"
#include "engine/geometry/views.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace raynest::cuda {

struct BinaryNode {
    Box box[2];              ///< box[1] is on the far side of `axis`
    std::uint32_t child[2];  ///< child_empty only if the wide node has fewer than two
    std::uint32_t axis;
};

class BinaryTrees {
public:
    /// Enough for every scene that compress() accepts: where a wide node on the way down leaves one
    /// entry, its waiting siblings, its binary nodes leave three. The last node, whose child is a
    /// leaf, leaves none in the wide tree and two here.
    static constexpr std::uint32_t stack_max = 3 * CompressedTrees::stack_max + 2;

    explicit BinaryTrees(const SceneView& scene) : scene_(&scene) {
        for (std::uint32_t o = 0; o < scene.object_count; ++o) add(scene.objects[o]);
    }

    /// The tree of one object. Its slots are 0 and 1 << axis, so `slot ^ octant` is the order in
    /// which a ray meets them, as with eight.
    struct Tree {
        const BinaryNode* nodes;
        const TriangleBlock* blocks;

        [[nodiscard]] std::uint32_t child(std::uint32_t node, std::uint32_t slot) const {
            return nodes[node].child[slot == 0 ? 0 : 1];
        }
        template <class Isect>
        [[nodiscard]] std::uint32_t entered(std::uint32_t node, const BoxRay& ray,
                                            Isect& isect) const {
            const BinaryNode& from = nodes[node];
            std::uint32_t mask = 0;
            for (const std::uint32_t side : {0U, 1U}) {
                if (from.child[side] == child_empty) continue;
                const std::uint32_t hit = intersect_with(isect, ray, BoxRef{&from.box[side]}).mask;
                mask |= hit << (side << from.axis ^ ray.slabs.octant);
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
        const auto index = static_cast<std::size_t>(&object - scene_->objects);
        return {nodes_.data() + first_node_[index], scene_->blocks + object.first_block};
    }

private:
    struct Child {
        Box box;
        std::uint32_t word;
    };
    static Vec3 center_of(const Box& box) { return 0.5F * box.lower + 0.5F * box.upper; }

    void add(const ObjectRecord& object) {
        const std::size_t first = nodes_.size();
        first_node_.push_back(first);
        nodes_.resize(first + object.node_count);
        for (std::uint32_t n = 0; n < object.node_count; ++n) {
            const Node& wide = scene_->nodes[object.first_node + n];
            std::vector<Child> children;
            for_each_lane<8>(wide.valid(), [&](int slot) {
                children.push_back({Boxes8{&wide}.box_of(slot), wide.child[slot]});
            });
            fill(first, n, children);
        }
    }

    // Fills node `to` of the object that starts at `first`.
    void fill(std::size_t first, std::uint32_t to, std::span<Child> children) {
        Box middles;
        for (const Child& child : children) middles.extend(center_of(child.box));
        const Vec3 spread = middles.size();
        int axis = 0;
        for (const int other : {1, 2}) {
            if (spread[other] > spread[axis]) axis = other;
        }
        std::sort(children.begin(), children.end(), [axis](const Child& a, const Child& b) {
            return center_of(a.box)[axis] < center_of(b.box)[axis];
        });
        nodes_[first + to].axis = static_cast<std::uint32_t>(axis);
        const std::size_t half = children.size() / 2;
        for (const std::uint32_t side : {0U, 1U}) {
            const Child joined =
                join(first, side == 0 ? children.first(half) : children.subspan(half));
            nodes_[first + to].box[side] = joined.box;
            nodes_[first + to].child[side] = joined.word;
        }
    }

    // Merges several children into one: a new node above them if there is more than one.
    Child join(std::size_t first, std::span<Child> children) {
        if (children.empty()) return {{}, child_empty};
        if (children.size() == 1) return children.front();
        const auto node = static_cast<std::uint32_t>(nodes_.size() - first);
        nodes_.emplace_back();
        fill(first, node, children);
        Box all;
        for (const Child& child : children) all.extend(child.box);
        return {all, node};
    }

    const SceneView* scene_;
    std::vector<BinaryNode> nodes_;
    std::vector<std::size_t> first_node_;  ///< by object
};

}  // namespace raynest::cuda
