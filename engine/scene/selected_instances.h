// A view of a scene in which some instances are hidden: their masks are 0, so no ray enters them.
#pragma once

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

/// The scene must outlive it. Not copied: view() points into it.
class SelectedInstances {
public:
    /// Fails with field_invalid for an instance or object that the scene lacks.
    static Result<std::vector<InstanceRecord>> select(const SceneView& scene,
                                                      const InstanceSelection& selection);

    SelectedInstances(const SceneView& scene, std::vector<InstanceRecord> instances)
        : instances_(std::move(instances)),
          view_(scene) {
        view_.instances = instances_.data();
    }
    SelectedInstances(const SelectedInstances&) = delete;

    [[nodiscard]] const SceneView& view() const { return view_; }

private:
    std::vector<InstanceRecord> instances_;
    SceneView view_;
};

}  // namespace raynest
