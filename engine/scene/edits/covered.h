// The instances that ranges of paths cover.
#pragma once

#include "engine/scene/edits/instance_place.h"
#include "engine/scene/named_paths.h"
#include "engine/scene/snapshot.h"

#include <cstddef>
#include <cstdint>
#include <string_view>
#include <vector>

namespace raynest {

/// Goes on from an instance of `object`, at the end of `way`, to what stands alone in it: while the
/// way is shorter than `steps`, and objects have one instance and nothing else. All of these
/// instances have the same placements, and the text of a path tells by its steps which one it means.
void go_to_step(const SceneView& view, std::uint32_t object, std::size_t steps,
                std::vector<std::uint32_t>& way);

/// Returns the steps of a text of a path.
[[nodiscard]] std::size_t steps_of(std::string_view text);

/// Finds the outermost instances all of whose placements lie in a range. `scene` must outlive it.
/// Not thread-safe.
class CoveredInstances {
public:
    /// Looks at no more than this many nested instances.
    CoveredInstances(const Snapshot& scene, std::uint64_t nested_max)
        : view_(scene.view()),
          nested_left_(nested_max) {}

    /// Appends those of a range, in order; returns false once it has looked at too many. `steps`: as
    /// in go_to_step(), from each of them.
    [[nodiscard]] bool find(const PathRange& range, std::size_t steps,
                            std::vector<InstancePlace>& found) {
        steps_ = steps;
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
    std::size_t steps_ = 0;
    std::vector<std::uint32_t> way_;
};

}  // namespace raynest
