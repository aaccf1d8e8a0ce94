#include "engine/scene/edits/link.h"

#include "engine/scene/edits/linked_content.h"
#include "engine/scene/edits/linked_paths.h"
#include "engine/scene/edits/shared_ways.h"
#include "engine/scene/motion/motion.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <utility>

namespace raynest {
namespace {

/// The objects of a scene, as WayCopies wants them.
struct CopiedObjects {
    LinkedContent& content;

    std::uint32_t keep(std::uint32_t object) { return content.keep(0, object); }
    std::uint32_t copy(std::uint32_t object, const std::vector<std::uint32_t>& children) {
        return content.copy(0, object, children);
    }
};

Result<void> check_placements(const AddedScene& added) {
    for (const Transform& to_scene : added.to_scene) {
        Transform inverse;
        if (!std::ranges::all_of(to_scene.m, [](float x) { return std::isfinite(x); }))
            return fail(
                ErrorCode::field_invalid,
                fmt::format("a placement of '{}' has numbers that are not finite", added.name));
        if (!invert(to_scene, inverse))
            return fail(
                ErrorCode::field_invalid,
                fmt::format("a placement of '{}' is singular: a scale of 0 leaves no way to bring "
                            "rays into its space",
                            added.name));
    }
    return {};
}

class Link {
public:
    Link(const Snapshot& base, std::span<const std::uint32_t> removed,
         std::span<const AddedScene> added, const EditGuard& guard)
        : base_(base),
          guard_(guard),
          removed_(removed),
          added_(added),
          has_nodes_(nodes_name(base, added)),
          content_(base) {}

    Result<BuiltArena> link(std::vector<std::byte> motion) {
        if (auto kept = keep_base(); !kept) return tl::unexpected(kept.error());
        if (!motion.empty()) content_.content().motion = std::move(motion);
        for (const AddedScene& added : added_)
            if (auto done = add(added); !done) return tl::unexpected(done.error());
        const SceneView& view = base_.view();
        const std::uint32_t name = content_.name(base_, view.objects[view.root].name);
        if (auto root = content_.add_root(name, std::move(instances_)); !root)
            return tl::unexpected(root.error());
        if (has_nodes_) {
            if (auto fits = check_nodes(); !fits) return tl::unexpected(fits.error());
            if (auto done = link_paths(base_, paths_, added_paths_, content_.content(), guard_);
                !done)
                return tl::unexpected(done.error());
            join_nodes(content_.content());
        }
        auto arena = content_.write(has_nodes_);
        if (!arena) return tl::unexpected(arena.error());
        return BuiltArena{std::move(*arena),
                          base_.statistics().build_seconds,
                          {.rebuilds = base_.statistics().edits.rebuilds + 1},
                          content_.trees_built()};
    }

private:
    [[nodiscard]] bool base_has_nodes() const { return base_.paths().node_count != 0; }

    Result<void> keep_base() {
        const SceneView& view = base_.view();
        const ObjectRecord& root = view.objects[view.root];
        if (root.has_own_primitives()) {
            if (!removed_.empty())
                return fail(ErrorCode::field_invalid,
                            "the scene has primitives of its own beside its instances: hide these "
                            "instead of removing them");
            content_.content().motion.clear();  // its instances are outermost no more
            LinkedContent::Placed& whole = instances_.emplace_back();
            whole.object = content_.keep(0, view.root);
            whole.name = content_.content().names.add(path_step_text(view.names + root.name));
            if (whole.name == 0) whole.number = 0;
            if (has_nodes_ && !base_has_nodes())
                added_paths_.push_back({&base_, whole.name, whole.number, 1});
            else
                paths_.push_back({0, root.placement_count});
            return {};
        }
        auto& motion = content_.content().motion;
        if (!removed_.empty()) motion = motion_without(motion, removed_);
        auto removed = removed_.begin();
        for (std::uint32_t i = 0; i < root.instance_count; ++i) {
            if (removed != removed_.end() && *removed == i) {
                ++removed;
                continue;
            }
            const std::uint32_t at = root.first_instance + i;
            const InstanceRecord& record = view.instances[at];
            const InstanceInfo& info = view.instance_infos[at];
            instances_.push_back(
                {content_.keep(0, record.object), info.to_parent, info.mask, info.uid,
                 content_.name(base_, info.name),
                 base_.paths().numbers == nullptr ? no_id : base_.paths().numbers[at]});
            const std::uint64_t end =
                record.path_base + view.objects[record.object].placement_count;
            if (!paths_.empty() && paths_.back().end == record.path_base)
                paths_.back().end = end;
            else
                paths_.push_back({record.path_base, end});
        }
        return {};
    }

    Result<void> add(const AddedScene& added) {
        if (auto checked = check_placements(added); !checked) return checked;
        const SceneView& view = added.scene->view();
        const auto [known, is_new] = scenes_.try_emplace(added.scene.get());
        if (is_new) known->second = content_.add_scene(*added.scene);
        const std::size_t scene = known->second;
        const std::uint32_t object = content_.keep(scene, view.root);
        const std::uint32_t name = content_.content().names.add(added.name);
        const auto copies = static_cast<std::uint32_t>(added.to_scene.size());
        // Where one node stands for all placements, each of them takes a number.
        const std::uint64_t each =
            has_nodes_ && is_one_node(*added.scene) ? view.objects[view.root].placement_count : 1;
        std::uint64_t number = next_of(name);
        if (number == no_id && (copies > 1 || each > 1 || added.is_numbered)) number = 0;
        if (number != no_id) {
            if (each > (no_id - 1 - number) / std::max(copies, 1U))
                return fail(ErrorCode::limit_exceeded,
                            fmt::format("'{}' has too many placements to number them", added.name));
            next_[name] = static_cast<std::uint32_t>(number + each * copies);
        } else {
            next_[name] = 1;
        }
        if (has_nodes_)
            added_paths_.push_back(
                {added.scene.get(), name, static_cast<std::uint32_t>(number), copies, added.uid});
        for (std::uint32_t i = 0; i < copies; ++i)
            instances_.push_back(
                {object, added.to_scene[i], added.masks[i], added.uid == no_id ? 0 : added.uid,
                 name, number == no_id ? no_id : static_cast<std::uint32_t>(number) + i});
        return {};
    }

    /// Each copy of a scene has nodes of its own, unless one stands for all.
    Result<void> check_nodes() const {
        std::map<const Snapshot*, std::uint64_t> known;
        std::uint64_t nodes = nodes_of_copy(base_);
        for (const AddedScene& added : added_) {
            const auto [each, is_new] = known.try_emplace(added.scene.get(), 0);
            if (is_new) each->second = nodes_of_copy(*added.scene);
            nodes += std::max<std::uint64_t>(each->second * added.to_scene.size(), 1);
            if (nodes > path_nodes_max)
                return fail(ErrorCode::limit_exceeded,
                            fmt::format("the scene would have over {} nodes that name its paths, "
                                        "{} in each copy of '{}': add it less often",
                                        path_nodes_max, each->second, added.name));
        }
        return {};
    }

    /// Returns the next free number of an outermost step, or no_id if there is none of that name.
    std::uint32_t next_of(std::uint32_t name) {
        if (const auto known = next_.find(name); known != next_.end()) return known->second;
        if (base_has_nodes()) return next_number(base_, name);
        std::uint32_t next = no_id;
        for (const LinkedContent::Placed& placed : instances_) {
            if (placed.name != name) continue;
            const std::uint32_t behind = placed.number == no_id ? 1 : placed.number + 1;
            next = next == no_id ? behind : std::max(next, behind);
        }
        return next;
    }

    const Snapshot& base_;
    const EditGuard& guard_;
    const std::span<const std::uint32_t> removed_;
    const std::span<const AddedScene> added_;
    const bool has_nodes_;  ///< the result
    LinkedContent content_;
    std::map<const Snapshot*, std::size_t> scenes_;  ///< numbers in content_ of what was added
    std::vector<LinkedContent::Placed> instances_;
    std::vector<PathRange> paths_;  ///< paths of the base that stay
    std::vector<AddedPaths> added_paths_;
    std::map<std::uint32_t, std::uint32_t> next_;  ///< free numbers of names that were added
};

}  // namespace

Result<BuiltArena> link_scenes(const Snapshot& base, std::span<const std::uint32_t> removed,
                               std::span<const AddedScene> added, const EditGuard& guard,
                               std::vector<std::byte> motion) {
    return Link(base, removed, added, guard).link(std::move(motion));
}

Result<BuiltArena> unshare(const Snapshot& base, const std::vector<InstancePlace>& ways,
                           std::span<const InstanceUid> uids) {
    LinkedContent content(base);
    CopiedObjects objects{content};
    WayCopies(base.view(), objects).copy(ways);
    const bool has_nodes = base.paths().node_count != 0;
    if (has_nodes) {
        const PathRange all{0, base.statistics().instances};
        if (auto done = link_paths(base, {&all, 1}, {}, content.content()); !done)
            return tl::unexpected(done.error());
        if (!uids.empty()) set_node_uids(base, uids, content.content());
        join_nodes(content.content());
    }
    auto arena = content.write(has_nodes);
    if (!arena) return tl::unexpected(arena.error());
    return BuiltArena{std::move(*arena), base.statistics().build_seconds, base.statistics().edits,
                      content.trees_built()};
}

}  // namespace raynest
