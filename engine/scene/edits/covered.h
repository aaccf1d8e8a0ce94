// The instances that ranges of paths cover.
#pragma once

#include "engine/scene/edits/instance_place.h"
#include "engine/scene/named_paths.h"
#include "engine/scene/snapshot.h"

#include <cstdint>
#include <vector>

namespace raynest {

/// Finds the outermost instances all of whose placements lie in a range. `scene` must outlive it.
/// Not thread-safe.
class CoveredInstances {
public:
    /// Looks at no more than this many nested instances.
    CoveredInstances(const Snapshot& scene, std::uint64_t nested_max)
        : view_(scene.view()),
          nested_left_(nested_max) {}

    /// Appends those of a range, in order; returns false once it has looked at too many.
    [[nodiscard]] bool find(const PathRange& range, std::vector<InstancePlace>& found) {
        return enter(view_.root, 0, range, found);
    }
    /// Placements of all that was found. Fewer than the ranges have where an object has primitives
    /// of its own whose instance lies only partly in them.
    [[nodiscard]] std::uint64_t placements() const { return placements_; }

private:
    bool enter(std::uint32_t object, std::uint64_t base, const PathRange& range,
               std::vector<InstancePlace>& found);

    const SceneView& view_;
    std::uint64_t nested_left_;
    std::uint64_t placements_ = 0;
    std::vector<std::uint32_t> way_;
};

}  // namespace raynest
