#include "engine/scene/edits/refit.h"

#include "engine/bvh/build_emit.h"
#include "engine/scene/edits/deform.h"
#include "engine/scene/edits/view_trees.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <bit>
#include <utility>

namespace raynest {
namespace {

Box box_of(const Node& node, std::size_t slot) {
    Box box;
    for (int axis = 0; axis < 3; ++axis) {
        box.lower[axis] = node.lower[axis][slot];
        box.upper[axis] = node.upper[axis][slot];
    }
    return box;
}

Box box_of(const Node& node) {
    Box box;
    const auto count = static_cast<std::size_t>(std::popcount(node.valid()));
    for (std::size_t slot = 0; slot < count; ++slot) box.extend(box_of(node, slot));
    return box;
}

bool in_range(const Box& box) {
    if (box.is_empty()) return true;
    const Vec3 reach = glm::max(glm::abs(box.lower), glm::abs(box.upper));
    return std::max({reach.x, reach.y, reach.z}) <= coordinate_max;
}

/// Makes the boxes above the changed instances of an object anew, and where it is `deformed` those
/// above its triangles. `boxes` are the instances', `change_of` says which is whose: no_id where
/// none is. Returns the box of where they were and where they are.
Box refit_object(EditedArena& arena, ObjectRecord& object, std::span<const std::uint32_t> change_of,
                 std::span<const Box> boxes, bool deformed) {
    const std::span<Node> nodes = arena.nodes(object);
    const auto set = [](Node& node, std::size_t slot, const Box& box) {
        for (int axis = 0; axis < 3; ++axis) {
            node.lower[axis][slot] = box.lower[axis];
            node.upper[axis][slot] = box.upper[axis];
        }
    };
    Box reached;
    std::vector<bool> changed(nodes.size());
    // A child has a larger index than its parent.
    for (std::size_t i = nodes.size(); i-- > 0;) {
        Node& node = nodes[i];
        const auto count = static_cast<std::uint32_t>(std::popcount(node.valid()));
        for (std::uint32_t slot = 0; slot < count; ++slot) {
            const std::uint32_t child = node.child[slot];
            if (!is_leaf(child)) {
                if (!changed[child]) continue;
                set(node, slot, box_of(nodes[child]));
            } else if (kind_of(child) == ChildKind::triangles) {
                if (!deformed) continue;
                set(node, slot, box_of_leaf(arena.view(), object, child));
            } else {
                if (kind_of(child) != ChildKind::instance) continue;
                const std::uint32_t change = change_of[leaf_instance(child)];
                if (change == no_id) continue;
                reached.extend(box_of(node, slot));
                reached.extend(boxes[change]);
                set(node, slot, boxes[change]);
            }
            changed[i] = true;
        }
        if (!changed[i]) continue;
        build::order_children(node, count);
        arena.touch(node);
    }
    if (!is_leaf(object.root)) {
        object.bounds = box_of(nodes[object.root]);
    } else if (deformed && kind_of(object.root) == ChildKind::triangles) {
        object.bounds = box_of_leaf(arena.view(), object, object.root);
    } else if (kind_of(object.root) == ChildKind::instance &&
               change_of[leaf_instance(object.root)] != no_id) {
        reached.extend(object.bounds);
        object.bounds = boxes[change_of[leaf_instance(object.root)]];
        reached.extend(object.bounds);
    }
    return reached;
}

}  // namespace

Refitted refit(EditedArena& arena, const ChangesByObject& by_object) {
    const ViewTrees trees(arena.view());
    Refitted done;
    // Children have smaller indices than their parents.
    for (const auto& [index, change] : by_object) {
        ObjectRecord& object = arena.object(index);
        const std::vector<ChangedPlace>& changes = change.places;
        if (!change.vertices.empty()) arena.add_degenerate(deform(arena, object, change.vertices));
        std::vector<std::uint32_t> change_of(object.instance_count, no_id);
        std::vector<Box> boxes(changes.size());
        std::vector<float> errors(changes.size());
        tbb::parallel_for(std::size_t{0}, changes.size(), [&](std::size_t i) {
            if (changes[i].to_parent == nullptr) return;
            const std::uint32_t at = object.first_instance + changes[i].place;
            Transform inverse;
            invert(*changes[i].to_parent, inverse);
            arena.info(at).to_parent = *changes[i].to_parent;
            arena.instance(at).to_object = by_columns(inverse);
        });
        tbb::parallel_for(std::size_t{0}, changes.size(), [&](std::size_t i) {
            const std::uint32_t at = object.first_instance + changes[i].place;
            const std::uint32_t child = arena.view().instances[at].object;
            const Transform& to_parent = arena.view().instance_infos[at].to_parent;
            errors[i] = placement_error(to_parent, arena.view().objects[child].origin_error);
            boxes[i] = place_box(trees, child, to_parent, errors[i]).box;
        });
        for (std::size_t i = 0; i < changes.size(); ++i) {
            if (!in_range(boxes[i])) done.far = Refitted::Far{index, changes[i].place};
            change_of[changes[i].place] = static_cast<std::uint32_t>(i);
            object.origin_error = std::max(object.origin_error, errors[i]);
            const std::uint32_t at = object.first_instance + changes[i].place;
            if (changes[i].to_parent == nullptr) continue;
            arena.touch(arena.instance(at));
            arena.touch(arena.info(at));
        }
        if (done.far) return done;
        const Box reached = refit_object(arena, object, change_of, boxes, !change.vertices.empty());
        arena.touch(object);
        if (index == arena.view().root) done.reached = reached;
    }
    return done;
}

}  // namespace raynest
