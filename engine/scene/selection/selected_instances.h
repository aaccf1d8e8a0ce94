// A view of a scene in which parts are hidden: the masks of their instances are 0, so no ray enters
// them, and primitives beside hidden or shown instances are in no leaf.
//
// Where a part is hidden at one of several places of a shared object, the view has records of its
// own for the objects on the way there. Nodes, triangles and all else stay the scene's, and so do
// ids of paths.
#pragma once

#include "engine/bvh/node.h"
#include "engine/geometry/views.h"
#include "engine/result.h"

#include <compare>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

namespace raynest {

/// A part of a scene, by the way down to it.
struct ScenePart {
    std::vector<std::uint32_t> way;  ///< places of instances in their objects, outermost first
    /// True: the primitives of the last object's own, beside its instances. False: all that the
    /// last instance places.
    bool own = false;

    auto operator<=>(const ScenePart&) const = default;
};

/// Returns the part that a path is; nothing if the scene has no such path.
[[nodiscard]] std::optional<ScenePart> part_of(const SceneView& scene, std::uint64_t path);

/// Instances are outermost ones, by their place in the root; objects by their place in the scene,
/// wherever they are placed.
struct InstanceSelection {
    std::span<const std::uint32_t> hidden_instances = {};
    std::span<const std::uint32_t> hidden_objects = {};
    /// If not empty, other outermost instances are hidden.
    std::span<const std::uint32_t> only_instances = {};
    /// If not empty, instances are hidden unless they lie in such an object or lead to one.
    std::span<const std::uint32_t> only_objects = {};
    /// Parts that the scene has.
    std::span<const ScenePart> hidden_parts = {};
    std::span<const ScenePart> only_parts = {};
    /// All is hidden but `only_parts` and `only_instances`, primitives beside instances too.
    bool only_named = false;

    [[nodiscard]] bool is_everything() const {
        return hidden_instances.empty() && hidden_objects.empty() && only_instances.empty() &&
               only_objects.empty() && hidden_parts.empty() && !only_named;
    }
};

/// The lists of a selection, owned.
struct InstanceLists {
    std::vector<std::uint32_t> hidden_instances;
    std::vector<std::uint32_t> hidden_objects;
    std::vector<std::uint32_t> only_instances;
    std::vector<std::uint32_t> only_objects;
    std::vector<ScenePart> hidden_parts = {};
    std::vector<ScenePart> only_parts = {};
    bool only_named = false;

    [[nodiscard]] InstanceSelection selection() const {
        return {hidden_instances, hidden_objects, only_instances, only_objects,
                hidden_parts,     only_parts,     only_named};
    }
    bool operator==(const InstanceLists&) const = default;
};

/// The scene must outlive it. Not copied: view() points into it.
class SelectedInstances {
public:
    /// Fails with field_invalid for an instance or object that the scene lacks. Takes no longer for
    /// a larger scene.
    static Result<void> check(const SceneView& scene, const InstanceSelection& selection);
    /// The instances of a view, and bytes of all records of its own, at most.
    struct Size {
        std::uint64_t instances = 0;
        std::uint64_t bytes = 0;
    };
    /// Without a look at instances, unless there are parts. With them it takes a look at each, and
    /// the time of the ways.
    static Size size(const SceneView& scene, const InstanceSelection& selection, bool skips_boxes);

    /// After check(). Takes 60 ms for a million instances. With `skips_boxes` the view has no boxes
    /// below which every instance has the mask 0; else they are tested, and counted. Boxes above
    /// them stay as large as they are.
    SelectedInstances(const SceneView& scene, const InstanceSelection& selection, bool skips_boxes);
    SelectedInstances(const SelectedInstances&) = delete;

    [[nodiscard]] const SceneView& view() const { return view_; }

    /// True if objects or instances of the view have other indices than in the scene.
    [[nodiscard]] bool has_copies() const { return !copied_objects_.empty(); }
    /// Index in the scene of an object or instance of the view; no_id stays.
    [[nodiscard]] std::uint32_t object_in_scene(std::uint32_t object) const {
        return in_scene(object, objects_before_, copied_objects_);
    }
    [[nodiscard]] std::uint32_t instance_in_scene(std::uint32_t instance) const {
        return in_scene(instance, instances_before_, copied_instances_);
    }

private:
    /// Gives the view nodes of its own.
    void prune(const std::vector<std::uint32_t>& without_own, bool skips_boxes);
    static std::uint32_t in_scene(std::uint32_t index, std::uint32_t before,
                                  const std::vector<std::uint32_t>& copied) {
        return index < before || index - before >= copied.size() ? index : copied[index - before];
    }

    const std::uint32_t objects_before_;    ///< objects of the scene; copies follow
    const std::uint32_t instances_before_;  ///< likewise
    std::vector<std::uint32_t> copied_objects_, copied_instances_;
    std::vector<ObjectRecord> objects_;  ///< empty: the scene's
    std::vector<InstanceRecord> instances_;
    std::vector<InstanceInfo> infos_;  ///< empty: the scene's
    std::vector<Node> nodes_;          ///< empty: the scene's
    SceneView view_;
};

}  // namespace raynest
