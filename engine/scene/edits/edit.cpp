#include "engine/scene/edits/edit.h"

#include "engine/bvh/build_emit.h"
#include "engine/scene/farthest.h"
#include "engine/scene/format.h"
#include "engine/scene/placed_box.h"

#include <fmt/format.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <string>
#include <utility>
#include <vector>

namespace raynest {
namespace {

using format::Section;

/// The trees of a finished scene.
class ViewTrees {
public:
    explicit ViewTrees(const SceneView& view) : view_(view) {}

    [[nodiscard]] ObjectTree tree(std::uint32_t object) const {
        const ObjectRecord& record = view_.objects[object];
        return {view_.nodes + record.first_node, record.root, record.bounds};
    }
    [[nodiscard]] TreePlacement placement(std::uint32_t object, std::uint32_t place) const {
        const std::size_t instance = view_.objects[object].first_instance + place;
        const std::uint32_t child = view_.instances[instance].object;
        const Transform& to_parent = view_.instance_infos[instance].to_parent;
        const ObjectRecord& record = view_.objects[child];
        return {child, to_parent,
                placed_padding(record.bounds, to_parent,
                               placement_error(to_parent, record.origin_error))};
    }
    /// Records have no box of their own any more: what is known of their leaf counts.
    [[nodiscard]] double farthest_in_leaf(std::uint32_t object, std::uint32_t leaf,
                                          const Reach& reach, double most) const {
        if (kind_of(leaf) == ChildKind::records) return most;
        double farthest = -std::numeric_limits<double>::infinity();
        const TriangleBlock* const first =
            view_.blocks + view_.objects[object].first_block + leaf_first(leaf);
        for (const TriangleBlock* block = first; block != first + leaf_count(leaf); ++block) {
            for (std::size_t lane = 0; lane < 8; ++lane) {
                if (block->triangle[lane] == no_id) continue;
                for (const auto& corner : block->vertex) {
                    const Vec3 point(corner[0][lane], corner[1][lane], corner[2][lane]);
                    farthest = std::max(farthest, reach.of(Box{point, point}));
                }
            }
        }
        return farthest;
    }

private:
    const SceneView& view_;
};

/// The parts of an arena that edits change.
class EditedArena {
public:
    EditedArena(Arena arena, const SceneView& before) : arena_(std::move(arena)), view_(before) {
        view_.nodes = section<Node>(Section::nodes);
        view_.objects = section<ObjectRecord>(Section::objects);
        view_.instances = section<InstanceRecord>(Section::instances);
        view_.instance_infos = section<InstanceInfo>(Section::instance_infos);
    }

    [[nodiscard]] const SceneView& view() const { return view_; }
    [[nodiscard]] ObjectRecord& root() { return section<ObjectRecord>(Section::objects)[view_.root]; }
    [[nodiscard]] std::span<Node> nodes() {
        return {section<Node>(Section::nodes) + root().first_node, root().node_count};
    }
    [[nodiscard]] std::span<InstanceRecord> instances() {
        return {section<InstanceRecord>(Section::instances) + root().first_instance,
                root().instance_count};
    }
    [[nodiscard]] std::span<InstanceInfo> infos() {
        return {section<InstanceInfo>(Section::instance_infos) + root().first_instance,
                root().instance_count};
    }
    void set_bounds(const Box& bounds) {
        Box& place = reinterpret_cast<format::Header*>(arena_.data())->bounds;
        place = bounds;
        touch(place);
    }
    [[nodiscard]] Arena take() { return std::move(arena_); }

    /// Notes that an element has changed.
    template <class T>
    void touch(const T& element) {
        const auto first = static_cast<std::size_t>(reinterpret_cast<const std::byte*>(&element) -
                                                    arena_.data());
        changed_[first / digest_piece_bytes] = true;
        changed_[(first + sizeof(T) - 1) / digest_piece_bytes] = true;
    }
    /// The pieces that have changed (scene/digest.h).
    [[nodiscard]] const std::vector<bool>& changed() const { return changed_; }

private:
    template <class T>
    T* section(Section which) {
        return const_cast<T*>(format::section<T>(arena_.data(), which));
    }

    Arena arena_;
    SceneView view_;
    std::vector<bool> changed_{
        std::vector<bool>((arena_.size() + digest_piece_bytes - 1) / digest_piece_bytes)};
};

/// Copies bytes on all threads.
void copy_bytes(std::byte* to, const std::byte* from, std::size_t count) {
    constexpr std::size_t part = 4U << 20;
    tbb::parallel_for(std::size_t{0}, (count + part - 1) / part, [&](std::size_t i) {
        std::memcpy(to + i * part, from + i * part, std::min(part, count - i * part));
    });
}

/// Copies an arena with another record and other nodes for its root, whose nodes are the last ones.
Arena with_root(std::span<const std::byte> from, std::uint32_t object, const ObjectRecord& root,
                std::span<const Node> nodes) {
    const auto& old = *reinterpret_cast<const format::Header*>(from.data());
    format::Header header = old;
    header.sections[0].count = root.first_node + nodes.size();
    std::uint64_t end = format::aligned(sizeof header);
    for (format::SectionEntry& entry : header.sections) {
        entry.offset = end;
        end = format::aligned(end + entry.count * entry.element_size);
    }
    header.bytes = end;
    Arena arena(end);
    std::memcpy(arena.data(), &header, sizeof header);
    for (std::size_t s = 0; s < format::section_count; ++s) {
        const format::SectionEntry& entry = header.sections[s];
        const std::uint64_t kept = s == 0 ? root.first_node : entry.count;
        copy_bytes(arena.data() + entry.offset, from.data() + old.sections[s].offset,
                   kept * entry.element_size);
    }
    std::memcpy(arena.data() + header.sections[0].offset + root.first_node * sizeof(Node),
                nodes.data(), nodes.size_bytes());
    const std::size_t objects = static_cast<std::size_t>(Section::objects);
    std::memcpy(arena.data() + header.sections[objects].offset + object * sizeof root, &root,
                sizeof root);
    return arena;
}

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

/// Makes the boxes above the moved instances anew. `boxes` are theirs, `move_of` says which is whose:
/// no_id where none is. Returns the box of where they were and where they are.
Box refit(EditedArena& arena, std::span<const std::uint32_t> move_of, std::span<const Box> boxes) {
    ObjectRecord& root = arena.root();
    const std::span<Node> nodes = arena.nodes();
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
            } else {
                if (kind_of(child) != ChildKind::instance) continue;
                const std::uint32_t move = move_of[leaf_instance(child)];
                if (move == no_id) continue;
                reached.extend(box_of(node, slot));
                reached.extend(boxes[move]);
                set(node, slot, boxes[move]);
            }
            changed[i] = true;
        }
        if (!changed[i]) continue;
        build::order_children(node, count);
        arena.touch(node);
    }
    if (!is_leaf(root.root)) {
        root.bounds = box_of(nodes[root.root]);
    } else if (kind_of(root.root) == ChildKind::instance &&
               move_of[leaf_instance(root.root)] != no_id) {
        reached.extend(root.bounds);
        root.bounds = boxes[move_of[leaf_instance(root.root)]];
        reached.extend(root.bounds);
    }
    return reached;
}

/// Builds the root's tree again, which has instances alone.
Result<std::shared_ptr<const Snapshot>> rebuild(const Snapshot& scene) {
    const SceneView& view = scene.view();
    ObjectRecord root = view.objects[view.root];
    std::vector<Box> boxes(root.instance_count);
    std::vector<float> errors(root.instance_count);
    const ViewTrees trees(view);
    tbb::parallel_for(std::uint32_t{0}, root.instance_count, [&](std::uint32_t i) {
        const std::uint32_t child = view.instances[root.first_instance + i].object;
        const Transform& to_parent = view.instance_infos[root.first_instance + i].to_parent;
        errors[i] = placement_error(to_parent, view.objects[child].origin_error);
        boxes[i] = place_box(trees, child, to_parent, errors[i]).box;
    });
    const Tree tree =
        build_tree({boxes, 0, 0, root.instance_count, scene.statistics().build});
    root.origin_error = std::max(1.0F, *std::ranges::max_element(errors));
    root.root = tree.root;
    root.bounds = tree.bounds;
    root.node_count = static_cast<std::uint32_t>(tree.nodes.size());
    return Snapshot::open({with_root(scene.bytes(), view.root, root, tree.nodes),
                           scene.statistics().build_seconds,
                           {.rebuilds = scene.statistics().edits.rebuilds + 1}});
}

bool is_inside(const Box& box, const Box& of) {
    return box.is_empty() || (glm::all(glm::greaterThan(box.lower, of.lower)) &&
                              glm::all(glm::lessThan(box.upper, of.upper)));
}

/// Returns the name of an outermost instance for messages.
std::string label(const Snapshot& scene, std::uint32_t instance) {
    const SceneView& view = scene.view();
    const ObjectRecord& root = view.objects[view.root];
    const std::uint64_t path = view.instances[root.first_instance + instance].path_base;
    const auto steps = expand_path(scene, path);
    return steps ? "'" + path_name(*steps) + "'" : "instance " + std::to_string(instance);
}

/// Says which move each outermost instance has; fails for those that the scene lacks.
template <class Change>
Result<std::vector<std::uint32_t>> changes_by_instance(const Snapshot& scene,
                                                       std::span<const Change> changes) {
    const std::uint32_t count = scene.view().objects[scene.view().root].instance_count;
    std::vector<std::uint32_t> of(changes.empty() ? 0 : count, no_id);
    for (std::size_t i = 0; i < changes.size(); ++i) {
        const std::uint32_t instance = changes[i].instance;
        if (instance >= count)
            return fail(ErrorCode::field_invalid,
                        fmt::format("there is no outermost instance {}: the scene has {}", instance,
                                    count));
        if (of[instance] != no_id)
            return fail(ErrorCode::field_invalid,
                        label(scene, instance) + " is named twice in one edit");
        of[instance] = static_cast<std::uint32_t>(i);
    }
    return of;
}

bool in_range(const Box& box) {
    if (box.is_empty()) return true;
    const Vec3 reach = glm::max(glm::abs(box.lower), glm::abs(box.upper));
    return std::max({reach.x, reach.y, reach.z}) <= coordinate_max;
}

}  // namespace

Result<std::shared_ptr<const Snapshot>> edit_scene(const Snapshot& scene,
                                                   std::span<const InstanceMove> moves,
                                                   std::span<const InstanceMask> masks,
                                                   std::shared_ptr<const Snapshot> spare) {
    const auto move_of = changes_by_instance(scene, moves);
    if (!move_of) return tl::unexpected(move_of.error());
    if (const auto known = changes_by_instance(scene, masks); !known)
        return tl::unexpected(known.error());
    std::vector<Transform> inverse(moves.size());
    for (std::size_t i = 0; i < moves.size(); ++i) {
        const Transform& to_scene = moves[i].to_scene;
        if (!std::ranges::all_of(to_scene.m, [](float x) { return std::isfinite(x); }))
            return fail(ErrorCode::field_invalid, "the placement of " +
                                                      label(scene, moves[i].instance) +
                                                      " has numbers that are not finite");
        if (!invert(to_scene, inverse[i]))
            return fail(ErrorCode::field_invalid,
                        "the placement of " + label(scene, moves[i].instance) +
                            " is singular: a scale of 0 leaves no way to bring rays into its space; "
                            "to hide it set its mask to 0");
    }

    EditedArena arena(Snapshot::copy_arena(scene, std::move(spare)), scene.view());
    ObjectRecord& root = arena.root();
    for (const InstanceMask& change : masks) {
        arena.instances()[change.instance].mask = change.mask;
        arena.touch(arena.instances()[change.instance]);
    }
    BuiltArena built;
    built.edits = scene.statistics().edits;
    if (built.edits.built_cost == 0) built.edits.built_cost = scene.statistics().trees.sah_cost;
    ++built.edits.refits;
    const auto refitted = [&] {
        std::vector<bool> changed = arena.changed();
        built.arena = arena.take();
        return Snapshot::open_edited(std::move(built), scene, std::move(changed));
    };
    if (moves.empty()) return refitted();

    std::vector<Box> boxes(moves.size());
    std::vector<float> errors(moves.size());
    const ViewTrees trees(arena.view());
    tbb::parallel_for(std::size_t{0}, moves.size(), [&](std::size_t i) {
        const InstanceMove& move = moves[i];
        InstanceRecord& record = arena.instances()[move.instance];
        arena.infos()[move.instance].to_parent = move.to_scene;
        record.to_object = by_columns(inverse[i]);
        errors[i] = placement_error(move.to_scene, arena.view().objects[record.object].origin_error);
        boxes[i] = place_box(trees, record.object, move.to_scene, errors[i]).box;
    });
    if (const auto far = std::ranges::find_if(boxes, [](const Box& box) { return !in_range(box); });
        far != boxes.end())
        return fail(ErrorCode::field_invalid,
                    label(scene, moves[static_cast<std::size_t>(far - boxes.begin())].instance) +
                        " would reach beyond 1e15");
    for (const InstanceMove& move : moves) {
        arena.touch(arena.instances()[move.instance]);
        arena.touch(arena.infos()[move.instance]);
    }
    root.origin_error = std::max(root.origin_error, *std::ranges::max_element(errors));
    const Box reached = refit(arena, *move_of, boxes);
    arena.touch(root);
    // A move within the scene leaves no side of it and reaches none.
    if (!is_inside(reached, scene.bounds()))
        arena.set_bounds(vertex_bounds(trees, arena.view().root));

    const double limit = rebuild_cost_factor * built.edits.built_cost;
    const bool may_rebuild = !root.has_own_primitives();
    auto edited = refitted();
    if (!edited || !may_rebuild || (*edited)->statistics().trees.sah_cost <= limit) return edited;
    return rebuild(**edited);
}

}  // namespace raynest
