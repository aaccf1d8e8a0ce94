#include "engine/scene/edits/refit.h"

#include "engine/bvh/build_emit.h"
#include "engine/scene/edits/view_trees.h"
#include "engine/scene/tree_statistics.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <bit>
#include <functional>
#include <set>

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

void set(Node& node, std::size_t slot, const Box& box) {
    for (int axis = 0; axis < 3; ++axis) {
        node.lower[axis][slot] = box.lower[axis];
        node.upper[axis][slot] = box.upper[axis];
    }
}

/// Returns the slot of a child, which the node has.
std::size_t slot_of(const Node& node, std::uint32_t child) {
    return static_cast<std::size_t>(std::ranges::find(node.child, child) - std::begin(node.child));
}

/// Makes the boxes above the changed instances of an object anew, and where it is `deformed` those
/// above its triangles. `boxes` are the instances', `change_of` says which is whose: no_id where
/// none is. Returns the box of where they were and where they are.
Box refit_object(EditedArena& arena, ObjectRecord& object, std::span<const std::uint32_t> change_of,
                 std::span<const Box> boxes, bool deformed) {
    const std::span<Node> nodes = arena.nodes(object);
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

/// Makes the boxes above a few changed instances of an object anew, and its expected cost: it was of
/// the `costs_before`, and what it places has the known ones. Returns the box of where they were and
/// where they are.
Box refit_few(EditedArena& arena, std::uint32_t index, const std::vector<ChangedPlace>& changes,
              std::span<const Box> boxes, std::span<const double> costs_before,
              TreeKnowledge& known, std::uint64_t& nodes_seen) {
    ObjectRecord& object = arena.object(index);
    const std::span<Node> nodes = arena.nodes(object);
    std::shared_ptr<const TreeLinks>& made = known.links[index];
    if (!made) made = std::make_shared<const TreeLinks>(links_of(arena.view(), object));
    const TreeLinks& links = *made;
    std::set<std::uint32_t, std::greater<>> above;  // a child has a larger index than its parent
    for (const ChangedPlace& change : changes)
        for (std::uint32_t node = links.holders[change.place]; node != no_id;
             node = links.parents[node])
            if (!above.insert(node).second) break;
    nodes_seen += above.size();
    const auto shares = [&](std::span<const double> costs) {
        CostShares sum;
        for (const std::uint32_t node : above)
            sum += cost_shares(arena.view(), object, nodes[node], costs);
        return sum;
    };
    const CostShares before = known.shares[index];
    CostShares& sum = known.shares[index];
    sum -= shares(costs_before);
    Box reached;
    for (std::size_t i = 0; i < changes.size(); ++i) {
        const std::uint32_t holder = links.holders[changes[i].place];
        if (holder == no_id) continue;
        const auto is_leaf_of = [&](std::uint32_t child) {
            return child != child_empty && is_leaf(child) &&
                   kind_of(child) == ChildKind::instance &&
                   leaf_instance(child) == changes[i].place;
        };
        Node& node = nodes[holder];
        const auto slot = static_cast<std::size_t>(std::ranges::find_if(node.child, is_leaf_of) -
                                                   std::begin(node.child));
        reached.extend(box_of(node, slot));
        reached.extend(boxes[i]);
        set(node, slot, boxes[i]);
    }
    for (const std::uint32_t i : above) {
        Node& node = nodes[i];
        build::order_children(node, static_cast<std::uint32_t>(std::popcount(node.valid())));
        arena.touch(node);
        known.extents->forget(index, i);
        if (links.parents[i] == no_id) continue;
        Node& parent = nodes[links.parents[i]];
        set(parent, slot_of(parent, i), box_of(node));
    }
    object.bounds = box_of(nodes[object.root]);
    sum += shares(known.costs);
    // A part that comes back from far away takes nearly all of a sum with it, and its digits.
    constexpr double digits_kept = 1.0 / (1 << 20);
    if (!(sum.nodes > digits_kept * before.nodes && sum.leaves > digits_kept * before.leaves))
        sum = cost_shares(arena.view(), object, known.costs);
    known.costs[index] = cost_of(arena.view(), object, sum, known.costs);
    return reached;
}

}  // namespace

Refitted refit(EditedArena& arena, const ChangesByObject& by_object,
               std::span<const double> costs_before, TreeKnowledge& known) {
    const ViewTrees trees(arena.view());
    Refitted done;
    // Children have smaller indices than their parents.
    for (const auto& [index, change] : by_object) {
        ObjectRecord& object = arena.object(index);
        const std::vector<ChangedPlace>& changes = change.places;
        if (!change.vertices.positions.empty())
            arena.add_degenerate(deform(arena, object, change.vertices));
        constexpr std::size_t many = 64;  // a node has up to so many in two levels below it
        const bool few =
            object.node_count / many > changes.size() && change.vertices.positions.empty();
        std::vector<std::uint32_t> change_of(few ? 0 : object.instance_count, no_id);
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
            if (!few) change_of[changes[i].place] = static_cast<std::uint32_t>(i);
            object.origin_error = std::max(object.origin_error, errors[i]);
            const std::uint32_t at = object.first_instance + changes[i].place;
            if (changes[i].to_parent == nullptr) continue;
            arena.touch(arena.instance(at));
            arena.touch(arena.info(at));
        }
        if (done.far) return done;
        arena.touch(object);
        Box reached;
        if (few) {
            reached = refit_few(arena, index, changes, boxes, costs_before, known, done.nodes);
        } else {
            reached =
                refit_object(arena, object, change_of, boxes, !change.vertices.positions.empty());
            known.shares[index] = cost_shares(arena.view(), object, known.costs);
            known.costs[index] = cost_of(arena.view(), object, known.shares[index], known.costs);
            known.extents->forget(index);
            done.nodes += object.node_count;
        }
        if (index == arena.view().root) done.reached = reached;
    }
    return done;
}

}  // namespace raynest
