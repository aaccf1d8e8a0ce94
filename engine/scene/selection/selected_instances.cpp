#include "engine/scene/selection/selected_instances.h"

#include "engine/bvh/build_emit.h"
#include "engine/geometry/path.h"

#include <algorithm>
#include <bit>
#include <map>
#include <string>

namespace raynest {
namespace {

Result<void> check_each(std::span<const std::uint32_t> chosen, std::uint32_t count,
                        const char* what) {
    const auto absent =
        std::ranges::find_if(chosen, [&](std::uint32_t index) { return index >= count; });
    if (absent == chosen.end()) return {};
    return fail(ErrorCode::field_invalid, "there is no " + std::string(what) + " " +
                                              std::to_string(*absent) + ": the scene has " +
                                              std::to_string(count));
}

/// Objects that rays enter when only some are shown.
struct Kept {
    std::vector<bool> leading;  ///< chosen, or with a chosen one somewhere below
    std::vector<bool> inside;   ///< chosen, or placed in a chosen one
};

Kept keep(const SceneView& scene, std::span<const std::uint32_t> chosen) {
    Kept kept{std::vector<bool>(scene.object_count), std::vector<bool>(scene.object_count)};
    for (const std::uint32_t object : chosen) kept.leading[object] = kept.inside[object] = true;
    const auto for_children = [&](std::uint32_t object, auto&& call) {
        const ObjectRecord& record = scene.objects[object];
        for (std::uint32_t k = 0; k < record.instance_count; ++k)
            call(scene.instances[record.first_instance + k].object);
    };
    for (std::uint32_t i = 0; i < scene.object_count; ++i)  // children come first
        for_children(i, [&](std::uint32_t child) {
            if (kept.leading[child]) kept.leading[i] = true;
        });
    for (std::uint32_t i = scene.object_count; i-- > 0;)
        if (kept.inside[i])
            for_children(i, [&](std::uint32_t child) { kept.inside[child] = true; });
    return kept;
}

/// Takes slots out of a tree: those of own primitives, or those that lead to hidden instances alone.
class Pruning {
public:
    /// Either may be left in.
    Pruning(std::span<Node> nodes, std::span<const InstanceRecord> instances, bool keeps_own,
            bool keeps_hidden)
        : nodes_(nodes),
          instances_(instances),
          keeps_own_(keeps_own),
          keeps_hidden_(keeps_hidden) {}

    /// True if anything below a child word stays. Trees are at most tree_height_max high.
    bool keeps(std::uint32_t child) {
        if (is_leaf(child)) {
            if (kind_of(child) != ChildKind::instance) return keeps_own_;
            return keeps_hidden_ || instances_[leaf_instance(child)].mask != 0;
        }
        Node& node = nodes_[child];
        const auto count = static_cast<std::uint32_t>(std::popcount(node.valid()));
        std::uint32_t kept = 0;
        for (std::uint32_t slot = 0; slot < count; ++slot)
            if (keeps(node.child[slot])) move_child(node, slot, kept++);
        if (kept == count) return true;
        std::fill(node.child + kept, node.child + count, child_empty);
        build::order_children(node, kept);
        return kept != 0;
    }

private:
    static void move_child(Node& node, std::uint32_t from, std::uint32_t to) {
        for (int axis = 0; axis < 3; ++axis) {
            node.lower[axis][to] = node.lower[axis][from];
            node.upper[axis][to] = node.upper[axis][from];
        }
        node.child[to] = node.child[from];
    }

    std::span<Node> nodes_;
    std::span<const InstanceRecord> instances_;
    const bool keeps_own_;
    const bool keeps_hidden_;
};

/// The fate of an instance, or of the root.
struct Branch {
    std::map<std::uint32_t, Branch> below;  ///< by the place of the instance
    bool hidden = false, shown = false;     ///< all of it
    bool own_hidden = false, own_shown = false;
    bool leads = false;  ///< it is shown, or something in it is
};

Branch branches(const InstanceSelection& selection) {
    Branch root;
    const auto end_of = [&root](std::span<const std::uint32_t> way, bool shown) -> Branch& {
        Branch* at = &root;
        for (const std::uint32_t place : way) {
            at = &at->below[place];
            at->leads = at->leads || shown;
        }
        return *at;
    };
    for (const ScenePart& part : selection.hidden_parts) {
        Branch& end = end_of(part.way, false);
        (part.own ? end.own_hidden : end.hidden) = true;
    }
    for (const ScenePart& part : selection.only_parts) {
        Branch& end = end_of(part.way, true);
        (part.own ? end.own_shown : end.shown) = true;
    }
    return root;
}

bool has_parts(const InstanceSelection& selection) {
    return !selection.hidden_parts.empty() || selection.only_named;
}

/// Objects have their nodes one behind the other, without gaps.
std::uint64_t node_count(const SceneView& scene) {
    const ObjectRecord& last = scene.objects[scene.object_count - 1];
    return last.first_node + last.node_count;
}

/// How often each object is placed.
std::vector<std::uint32_t> count_uses(const SceneView& scene) {
    std::vector<std::uint32_t> uses(scene.object_count);
    for (std::uint32_t i = 0; i < scene.instance_count; ++i) ++uses[scene.instances[i].object];
    return uses;
}

/// The records of a view that its parts change.
struct Records {
    std::vector<ObjectRecord> objects;  ///< those of the scene, and copies
    std::vector<InstanceRecord>& instances;
    std::vector<std::uint32_t>& copied_objects;    ///< index in the scene of each copy
    std::vector<std::uint32_t>& copied_instances;  ///< likewise
    std::vector<std::uint32_t> without_own = {};   ///< objects whose own primitives are hidden
};

/// Follows the branches, with copies of objects that are placed elsewhere, too.
class Ways {
public:
    /// Without records it only sums up.
    Ways(const SceneView& scene, Records* records)
        : scene_(scene),
          records_(records),
          uses_(count_uses(scene)) {}

    void follow(const InstanceSelection& selection) {
        Branch root = branches(selection);
        for (const std::uint32_t place : selection.only_instances) {
            shown_.resize(scene_.objects[scene_.root].instance_count);
            shown_[place] = true;
        }
        for (auto& [place, child] : root.below)
            if (!shown_.empty() && shown_[place]) child.shown = child.leads = true;
        follow(root, {scene_.root, scene_.root, false}, selection.only_named);
    }

    std::uint64_t instances = 0, nodes = 0, objects = 0;  ///< counts of copies
    bool hides_own = false;

private:
    struct Object {
        std::uint32_t in_scene;
        std::uint32_t in_view;
        bool is_copy;
    };

    [[nodiscard]] const ObjectRecord& record(const Object& object) const {
        return scene_.objects[object.in_scene];
    }

    void follow(const Branch& branch, const Object& object, bool only) {
        if (only) {
            for (std::uint32_t place = 0; place < record(object).instance_count; ++place) {
                if (object.in_scene == scene_.root && !shown_.empty() && shown_[place]) continue;
                const auto known = branch.below.find(place);
                if (known == branch.below.end() || !known->second.leads) hide(object, place);
            }
        }
        for (const auto& [place, child] : branch.below) {
            const bool only_below = only && !child.shown;
            if (child.hidden)
                hide(object, place);
            else if ((!only || child.leads) &&
                     (only_below || child.own_hidden || !child.below.empty()))
                follow(child, enter(object, place), only_below);
        }
        if ((branch.own_hidden || (only && !branch.own_shown)) &&
            record(object).has_own_primitives()) {
            hides_own = true;
            if (records_ != nullptr) records_->without_own.push_back(object.in_view);
        }
    }

    [[nodiscard]] InstanceRecord& instance(const Object& object, std::uint32_t place) {
        return records_->instances[records_->objects[object.in_view].first_instance + place];
    }

    void hide(const Object& object, std::uint32_t place) {
        if (records_ != nullptr) instance(object, place).mask = 0;
    }

    /// Returns the object of an instance, to be changed there alone.
    Object enter(const Object& above, std::uint32_t place) {
        const std::uint32_t child = scene_.instances[record(above).first_instance + place].object;
        if (!above.is_copy && uses_[child] == 1) return {child, child, false};
        const ObjectRecord& from = scene_.objects[child];
        --uses_[child];
        for (std::uint32_t i = 0; i < from.instance_count; ++i)
            ++uses_[scene_.instances[from.first_instance + i].object];
        ++objects;
        instances += from.instance_count;
        nodes += from.node_count;
        if (records_ == nullptr) return {child, child, true};
        Records& all = *records_;
        const auto made = static_cast<std::uint32_t>(all.objects.size());
        instance(above, place).object = made;
        ObjectRecord copy = all.objects[child];
        const std::uint32_t first = copy.first_instance;
        copy.first_instance = static_cast<std::uint32_t>(all.instances.size());
        all.objects.push_back(copy);
        all.copied_objects.push_back(child);
        for (std::uint32_t i = first; i < first + copy.instance_count; ++i) {
            all.instances.push_back(InstanceRecord(all.instances[i]));
            all.copied_instances.push_back(i);
        }
        return {child, made, true};
    }

    const SceneView& scene_;
    Records* const records_;
    std::vector<std::uint32_t> uses_;  ///< by the scene's objects
    std::vector<bool> shown_;          ///< outermost instances; empty: none
};

/// Fails where one of `hidden` is also one of `shown`.
Result<void> check_contradiction(std::span<const std::uint32_t> hidden,
                                 std::span<const std::uint32_t> shown, const char* what) {
    const auto both = std::ranges::find_if(hidden, [&](std::uint32_t index) {
        return std::ranges::find(shown, index) != shown.end();
    });
    if (both == hidden.end()) return {};
    return fail(ErrorCode::field_invalid, "`hide` and `only` both name " + std::string(what) + " " +
                                              std::to_string(*both) +
                                              ": leave it out of one of them");
}

}  // namespace

Result<void> SelectedInstances::check(const SceneView& scene, const InstanceSelection& selection) {
    const ObjectRecord& root = scene.objects[scene.root];
    for (const auto chosen : {selection.hidden_instances, selection.only_instances})
        if (auto known = check_each(chosen, root.instance_count, "outermost instance"); !known)
            return known;
    for (const auto chosen : {selection.hidden_objects, selection.only_objects})
        if (auto known = check_each(chosen, scene.object_count, "object"); !known) return known;
    if (auto clear = check_contradiction(selection.hidden_instances, selection.only_instances,
                                         "outermost instance");
        !clear)
        return clear;
    return check_contradiction(selection.hidden_objects, selection.only_objects, "object");
}

std::optional<ScenePart> part_of(const SceneView& scene, std::uint64_t path) {
    ScenePart part;
    std::uint32_t first = scene.objects[scene.root].first_instance;
    const ObjectRecord* const object = walk_path(scene, path, [&](std::uint32_t index) {
        part.way.push_back(index - first);
        first = scene.objects[scene.instances[index].object].first_instance;
    });
    if (object == nullptr) return std::nullopt;
    part.own = part.way.empty() || object->instance_count != 0;
    return part;
}

SelectedInstances::Size SelectedInstances::size(const SceneView& scene,
                                                const InstanceSelection& selection,
                                                bool skips_boxes) {
    Size size;
    size.instances = scene.instance_count;
    std::uint64_t nodes = skips_boxes ? node_count(scene) : 0;
    if (has_parts(selection)) {
        Ways ways(scene, nullptr);
        ways.follow(selection);
        size.instances += ways.instances;
        if (skips_boxes || ways.hides_own) nodes = node_count(scene) + ways.nodes;
        size.bytes = (scene.object_count + ways.objects) * sizeof(ObjectRecord) +
                     (ways.objects == 0 ? 0 : size.instances * sizeof(InstanceInfo));
    }
    size.bytes += size.instances * sizeof(InstanceRecord) + nodes * sizeof(Node);
    return size;
}

SelectedInstances::SelectedInstances(const SceneView& scene, const InstanceSelection& selection,
                                     bool skips_boxes)
    : objects_before_(scene.object_count),
      instances_before_(scene.instance_count),
      view_(scene) {
    instances_.reserve(size(scene, selection, skips_boxes).instances);
    instances_.assign(scene.instances, scene.instances + scene.instance_count);
    const ObjectRecord& root = scene.objects[scene.root];
    const auto outermost = std::span(instances_).subspan(root.first_instance, root.instance_count);
    if (!selection.only_instances.empty() && !selection.only_named) {
        std::vector<bool> shown(outermost.size());
        for (const std::uint32_t index : selection.only_instances) shown[index] = true;
        for (std::size_t i = 0; i < outermost.size(); ++i)
            if (!shown[i]) outermost[i].mask = 0;
    }
    for (const std::uint32_t index : selection.hidden_instances) outermost[index].mask = 0;
    if (!selection.only_objects.empty()) {
        const Kept kept = keep(scene, selection.only_objects);
        for (std::uint32_t i = 0; i < scene.object_count; ++i) {
            if (kept.inside[i]) continue;
            const ObjectRecord& object = scene.objects[i];
            for (std::uint32_t k = 0; k < object.instance_count; ++k) {
                InstanceRecord& instance = instances_[object.first_instance + k];
                if (!kept.leading[instance.object]) instance.mask = 0;
            }
        }
    }
    std::vector<bool> hidden(scene.object_count);
    for (const std::uint32_t object : selection.hidden_objects) hidden[object] = true;
    for (InstanceRecord& instance : instances_)
        if (hidden[instance.object]) instance.mask = 0;

    std::vector<std::uint32_t> without_own;
    if (has_parts(selection)) {
        Records records{{scene.objects, scene.objects + scene.object_count},
                        instances_,
                        copied_objects_,
                        copied_instances_};
        Ways(scene, &records).follow(selection);
        objects_ = std::move(records.objects);
        without_own = std::move(records.without_own);
        if (has_copies()) {
            infos_.reserve(instances_.size());
            infos_.assign(scene.instance_infos, scene.instance_infos + scene.instance_count);
            for (const std::uint32_t i : copied_instances_) infos_.push_back(infos_[i]);
            view_.instance_infos = infos_.data();
        }
    }
    if (skips_boxes || !without_own.empty()) prune(without_own, skips_boxes);
    view_.instances = instances_.data();
    view_.instance_count = static_cast<std::uint32_t>(instances_.size());
    if (!objects_.empty()) {
        view_.objects = objects_.data();
        view_.object_count = static_cast<std::uint32_t>(objects_.size());
    }
    if (!nodes_.empty()) view_.nodes = nodes_.data();
}

void SelectedInstances::prune(const std::vector<std::uint32_t>& without_own, bool skips_boxes) {
    std::uint64_t nodes = node_count(view_);
    for (std::size_t i = objects_before_; i < objects_.size(); ++i) nodes += objects_[i].node_count;
    nodes_.reserve(nodes);
    nodes_.assign(view_.nodes, view_.nodes + node_count(view_));
    if (objects_.empty()) objects_.assign(view_.objects, view_.objects + view_.object_count);
    for (std::size_t i = objects_before_; i < objects_.size(); ++i) {
        ObjectRecord& copy = objects_[i];
        const std::uint64_t first = std::exchange(copy.first_node, nodes_.size());
        for (std::uint64_t n = first; n < first + copy.node_count; ++n)
            nodes_.push_back(Node(nodes_[n]));
    }
    const auto prune_one = [&](ObjectRecord& object, bool keeps_own) {
        if (!Pruning(std::span(nodes_).subspan(object.first_node, object.node_count),
                     std::span(instances_).subspan(object.first_instance, object.instance_count),
                     keeps_own, !skips_boxes)
                 .keeps(object.root) &&
            is_leaf(object.root))
            object.root = child_empty;
    };
    for (const std::uint32_t i : without_own) {
        ObjectRecord& object = objects_[i];
        prune_one(object, false);
        // The reference goes by these.
        object.block_count = object.triangle_count = object.record_count = 0;
    }
    if (!skips_boxes) return;
    for (ObjectRecord& object : objects_)
        if (object.instance_count != 0) prune_one(object, true);
}

}  // namespace raynest
