// A view of a scene in which some instances are hidden: their masks are 0, so no ray enters them.
#pragma once

#include "engine/bvh/node.h"
#include "engine/geometry/views.h"
#include "engine/result.h"

#include <cstdint>
#include <span>
#include <utility>
#include <vector>

namespace raynest {

/// Instances are outermost ones, by their place in the root; objects by their place in the scene,
/// wherever they are placed.
struct InstanceSelection {
    std::span<const std::uint32_t> hidden_instances = {};
    std::span<const std::uint32_t> hidden_objects = {};
    /// If not empty, other outermost instances are hidden.
    std::span<const std::uint32_t> only_instances = {};
    /// If not empty, instances are hidden unless they lie in such an object or lead to one.
    std::span<const std::uint32_t> only_objects = {};

    [[nodiscard]] bool is_everything() const {
        return hidden_instances.empty() && hidden_objects.empty() && only_instances.empty() &&
               only_objects.empty();
    }
};

/// The lists of a selection, owned.
struct InstanceLists {
    std::vector<std::uint32_t> hidden_instances;
    std::vector<std::uint32_t> hidden_objects;
    std::vector<std::uint32_t> only_instances;
    std::vector<std::uint32_t> only_objects;

    [[nodiscard]] InstanceSelection selection() const {
        return {hidden_instances, hidden_objects, only_instances, only_objects};
    }
};

/// The scene must outlive it. Not copied: view() points into it.
class SelectedInstances {
public:
    /// Fails with field_invalid for an instance or object that the scene lacks. Takes no longer for
    /// a larger scene.
    static Result<void> check(const SceneView& scene, const InstanceSelection& selection);
    /// Returns the scene's instances with masks for this selection, after check(). Takes 60 ms for
    /// a million instances.
    static Result<std::vector<InstanceRecord>> select(const SceneView& scene,
                                                      const InstanceSelection& selection);

    /// Returns the scene's nodes without the boxes below which every instance has the mask 0. Boxes
    /// above them stay as large as they are. Takes 256 bytes for each node of the scene: see
    /// node_count().
    static std::vector<Node> prune(const SceneView& scene,
                                   std::span<const InstanceRecord> instances);
    [[nodiscard]] static std::uint64_t node_count(const SceneView& scene);

    /// Without `nodes`, the scene's: boxes of hidden instances are tested, and counted.
    SelectedInstances(const SceneView& scene, std::vector<InstanceRecord> instances,
                      std::vector<Node> nodes = {})
        : instances_(std::move(instances)),
          nodes_(std::move(nodes)),
          view_(scene) {
        view_.instances = instances_.data();
        if (!nodes_.empty()) view_.nodes = nodes_.data();
    }
    SelectedInstances(const SelectedInstances&) = delete;

    [[nodiscard]] const SceneView& view() const { return view_; }

private:
    std::vector<InstanceRecord> instances_;
    std::vector<Node> nodes_;
    SceneView view_;
};

}  // namespace raynest
