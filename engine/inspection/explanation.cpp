#include "engine/inspection/explanation.h"

#include "engine/bvh/node.h"
#include "engine/geometry/moved_box.h"
#include "engine/intersectors/counts.h"

#include <bit>
#include <new>
#include <utility>

namespace raynest {
namespace {

/// A child word without the size of its leaf: what a visit of the child can tell of it.
std::uint32_t key_of(std::uint32_t child) {
    return is_leaf(child) && kind_of(child) != ChildKind::instance ? child & ~7U : child;
}

}  // namespace

ExplanationRecorder::ExplanationRecorder(const Snapshot& scene, std::size_t entries_max)
    : scene_(scene),
      entries_max_(entries_max) {
    observer_.context = this;
    observer_.candidates = 1;
    observer_.step = [](void* recorder, const Step* step) noexcept {
        auto& self = *static_cast<ExplanationRecorder*>(recorder);
        try {
            if (!self.failed_) self.add(*step);
        } catch (const std::bad_alloc&) {
            self.failed_ = true;
        }
    };
    observer_.end = [](void* recorder, std::uint32_t /*ray*/, const HitRecord* hit) noexcept {
        static_cast<ExplanationRecorder*>(recorder)->told_.hit = *hit;
    };
    const SceneView& view = scene.view();
    told_.levels.resize(1);
    Level root;
    root.object = view.root;
    root.bounds = view.objects[view.root].bounds;
    descent_.begin(std::move(root));
}

Explanation ExplanationRecorder::take() {
    if (failed_) throw std::bad_alloc();
    return std::move(told_);
}

void ExplanationRecorder::add(const Step& step) {
    Level& level = descent_.at(step);
    count(step);
    switch (step.kind) {
        case step_node:
            return add_node(level, step);
        case step_primitives:
            return add_primitives(level, step);
        case step_candidate:
            return add_candidate(step);
        case step_instance:
            return add_instance(step);
    }
}

void ExplanationRecorder::count(const Step& step) {
    if (told_.levels.size() <= depth()) told_.levels.resize(depth() + 1);
    if (step.kind == step_primitives && (step.passed | step.rejected) != 0) leave_missed();
    for (Counters* c : {&told_.totals, &told_.levels[depth()]}) {
        if (step.kind == step_node) {
            count_node(*c, step.tested);
            count_box_hits(*c, step.passed);
        } else if (step.kind == step_primitives) {
            count_primitives(*c, step.first, lanes_of(step.tested));
            count_candidates(*c, step.passed | step.rejected, step.rejected);
        } else if (step.kind == step_instance && step.outcome == outcome_accepted) {
            count_instance(*c);
        }
    }
}

void ExplanationRecorder::leave_missed() {
    for (std::uint32_t level = 1; level <= depth(); ++level) {
        if (!std::exchange(descent_.levels()[level].missed, false)) continue;
        count_instances_hit(told_.totals, 1);
        count_instances_hit(told_.levels[level - 1], 1);
    }
}

std::uint32_t ExplanationRecorder::append(Level& level, std::uint32_t key, ExplainedEntry entry) {
    entry.parent = level.entry;
    entry.box = level.bounds;
    entry.near = level.near;
    if (const auto child = level.entered.find(key); child != level.entered.end()) {
        entry.parent = child->second.parent;
        entry.box = child->second.box;
        entry.near = child->second.near;
        --told_.entries[entry.parent].behind;
        level.entered.erase(child);
    }
    if (told_.entries.size() >= entries_max_) {
        ++told_.left_out[static_cast<std::size_t>(entry.kind)];
        return no_id;
    }
    told_.entries.push_back(entry);
    return static_cast<std::uint32_t>(told_.entries.size() - 1);
}

void ExplanationRecorder::add_node(Level& level, const Step& step) {
    ExplainedEntry entry;
    entry.kind = EntryKind::node;
    entry.level = depth();
    entry.object = step.object;
    entry.place = step.place;
    entry.tested = lanes_of(step.tested);
    entry.passed = entry.behind = lanes_of(step.passed);
    entry.refused = lanes_of(step.rejected);
    const std::uint32_t index = append(level, step.place, entry);
    if (index == no_id) return;
    const SceneView& view = scene_.view();
    const Node& node = view.nodes[view.objects[step.object].first_node + step.place];
    for (std::uint32_t lanes = step.passed; lanes != 0; lanes &= lanes - 1) {
        const int lane = std::countr_zero(lanes);
        const Box box{{node.lower[0][lane], node.lower[1][lane], node.lower[2][lane]},
                      {node.upper[0][lane], node.upper[1][lane], node.upper[2][lane]}};
        level.entered[key_of(node.child[lane])] = {index, step.nears[lane],
                                                   moved_box(box, level.to_world)};
    }
}

void ExplanationRecorder::add_primitives(Level& level, const Step& step) {
    if (step.first != 0) {
        ExplainedEntry entry;
        entry.kind = EntryKind::leaf;
        entry.level = depth();
        entry.object = step.object;
        entry.place = step.place;
        const bool triangles = scene_.view().objects[step.object].triangle_count != 0;
        leaf_ = append(
            level, make_leaf(triangles ? ChildKind::triangles : ChildKind::records, step.place, 1),
            entry);
    }
    if (leaf_ == no_id) return;
    ExplainedEntry& leaf = told_.entries[leaf_];
    leaf.tested += lanes_of(step.tested);
    leaf.passed += lanes_of(step.passed);
    leaf.refused += lanes_of(step.rejected);
}

void ExplanationRecorder::add_candidate(const Step& step) {
    if (leaf_ == no_id || told_.entries.size() >= entries_max_) {
        if (step.outcome == outcome_accepted) told_.hit_entry = no_id;
        ++told_.left_out[static_cast<std::size_t>(EntryKind::candidate)];
        return;
    }
    ExplainedEntry entry;
    entry.kind = EntryKind::candidate;
    entry.outcome = step.outcome;
    entry.parent = leaf_;
    entry.level = depth();
    entry.object = step.object;
    entry.place = step.place;
    entry.placements = {step.path, 1};
    entry.t = step.t;
    entry.u = step.u;
    entry.v = step.v;
    entry.front = step.front != 0;
    entry.refusal = step.refusal;
    if (step.outcome == outcome_accepted)
        told_.hit_entry = static_cast<std::uint32_t>(told_.entries.size());
    told_.entries.push_back(entry);
}

void ExplanationRecorder::add_instance(const Step& step) {
    const SceneView& view = scene_.view();
    const InstanceRecord& instance = view.instances[step.place];
    const ObjectRecord& object = view.objects[instance.object];
    Level& parent = descent_.levels().back();
    Level level;
    level.object = instance.object;
    level.instance = step.place;
    level.to_world = compose(parent.to_world, view.instance_infos[step.place].to_parent);

    ExplainedEntry entry;
    entry.kind = EntryKind::instance;
    entry.outcome = step.outcome;
    entry.level = depth() + 1;
    entry.object = instance.object;
    entry.place = step.place;
    entry.placements = {step.path + instance.path_base, object.placement_count};
    const std::uint32_t first = view.objects[step.object].first_instance;
    level.entry = append(parent, make_instance_leaf(step.place - first), entry);
    // The root of the tree has no box that was tested: it has the instance's.
    if (level.entry != no_id) {
        level.near = told_.entries[level.entry].near;
        level.bounds = told_.entries[level.entry].box;
    }
    if (step.outcome == outcome_accepted) descent_.enter(std::move(level));
}

}  // namespace raynest
