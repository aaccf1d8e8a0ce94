#include "engine/scene/checks/tree_check.h"

#include "engine/bvh/node.h"
#include "engine/geometry/triangle.h"

#include <algorithm>
#include <bit>

namespace raynest {
namespace {

tl::unexpected<Error> broken_tree(const char* what) {
    return fail(ErrorCode::scene_invalid, std::string("a tree is broken: ") + what);
}

/// True if the valid slots are the first ones, and each of the eight octants lists them before the others.
bool is_order(const Node& node) {
    const std::uint32_t valid = node.valid();
    if ((valid & (valid + 1)) != 0) return false;
    const int count = std::popcount(valid);
    for (std::uint32_t octant = 0; octant < 8; ++octant) {
        std::uint32_t slots = 0;
        for (int i = 0; i < 8; ++i) {
            slots |= 1U << (node.order[i] >> (3 * octant) & 7U);
            if (i + 1 == count && slots != valid) return false;
        }
        if (slots != 0xFF) return false;
    }
    return true;
}

/// Marks a run of leaf entries; false if it leaves the object or overlaps another run.
bool claim(std::vector<bool>& seen, std::uint32_t first, std::uint32_t count) {
    if (first > seen.size() || count > seen.size() - first) return false;
    for (std::uint32_t i = first; i < first + count; ++i) {
        if (seen[i]) return false;
        seen[i] = true;
    }
    return true;
}

bool all_seen(const std::vector<bool>& seen) {
    return std::find(seen.begin(), seen.end(), false) == seen.end();
}

}  // namespace

Result<void> TreeChecker::check(const SceneView& scene, const ObjectRecord& object) {
    object_ = &object;
    node_height_.assign(object.node_count, 0);
    block_seen_.assign(object.block_count, false);
    record_seen_.assign(object.record_count, false);
    instance_seen_.assign(object.instance_count, false);

    // Node 0 is the root, unless the root is a leaf or empty.
    if (object.node_count != 0) {
        if (object.root != 0) return broken_tree("its root is not its first node");
        node_height_[0] = 1;
    } else if (object.root != child_empty) {
        if (!is_leaf(object.root)) return broken_tree("its root names a node that does not exist");
        if (auto checked = check_leaf(object.root); !checked) return checked;
    }

    // Children come after their parents, so one pass in order suffices.
    for (std::uint32_t i = 0; i < object.node_count; ++i) {
        const Node& node = scene.nodes[object.first_node + i];
        if (auto checked = check_node(node, i); !checked) return checked;
    }
    if (!all_seen(block_seen_) || !all_seen(record_seen_))
        return broken_tree("a leaf is not in it");
    return check_blocks(scene.blocks + object.first_block);
}

Result<void> TreeChecker::check_node(const Node& node, std::uint32_t index) {
    const std::uint8_t height = node_height_[index];
    if (height == 0) return broken_tree("a node has no parent before it");
    if (height > tree_height_max) return broken_tree("it is too high");
    if (!is_order(node)) return broken_tree("an octant order is not an order");
    for (std::uint32_t slot = 0; slot < 8; ++slot) {
        const std::uint32_t child = node.child[slot];
        const bool used = (node.valid() >> slot & 1U) != 0;
        if (used != (child != child_empty)) return broken_tree("a slot contradicts the valid mask");
        if (!used) continue;
        if (is_leaf(child)) {
            if (auto checked = check_leaf(child); !checked) return checked;
            continue;
        }
        if (child <= index || child >= node_height_.size() || node_height_[child] != 0) {
            return broken_tree("a node is named twice, before its parent, or does not exist");
        }
        node_height_[child] = static_cast<std::uint8_t>(height + 1);
    }
    return {};
}

Result<void> TreeChecker::check_leaf(std::uint32_t leaf) {
    bool sound = false;
    switch (kind_of(leaf)) {
        case ChildKind::triangles:
            sound = claim(block_seen_, leaf_first(leaf), leaf_count(leaf));
            break;
        case ChildKind::records:
            sound = claim(record_seen_, leaf_first(leaf), leaf_count(leaf));
            break;
        case ChildKind::instance:
            sound = claim(instance_seen_, leaf_instance(leaf), 1);
            break;
    }
    if (!sound) return broken_tree("a leaf leaves its object or overlaps another");
    return {};
}

Result<void> TreeChecker::check_blocks(const TriangleBlock* blocks) const {
    for (std::uint32_t b = 0; b < object_->block_count; ++b) {
        for (std::size_t lane = 0; lane < 8; ++lane) {
            const std::uint32_t triangle = blocks[b].triangle[lane];
            if (triangle < object_->triangle_count) continue;
            bool padding = triangle == no_id;
            for (const auto& corner : blocks[b].vertex) {
                for (const auto& axis : corner) padding = padding && axis[lane] == 0;
            }
            if (!padding) return broken_tree("a block names a triangle that does not exist");
        }
    }
    return {};
}

}  // namespace raynest
