// The view of a scene in which a job hides parts.
#pragma once

#include "engine/packs/observer.h"
#include "engine/scene/selection/find_parts.h"
#include "engine/scene/selection/selected_instances.h"
#include "server/ground/budget.h"
#include "server/ground/errors.h"
#include "server/ground/stop.h"

#include <atomic>
#include <cstdint>
#include <mutex>
#include <optional>
#include <span>
#include <string>

namespace raynest::server {

/// The words of a job that say what it hides.
struct SelectionWords {
    InstanceLists lists;
    PathNames hidden, only;
    bool skips_boxes = false;  ///< boxes that lead to hidden instances alone are not in the view

    [[nodiscard]] bool is_everything() const {
        return lists.selection().is_everything() && hidden.empty() && only.empty();
    }
    bool operator==(const SelectionWords&) const = default;
};

/// Made from the words in a task. Thread-safe once it is made.
class Selected {
public:
    /// `lease` holds least_bytes() for the principal.
    Selected(SelectionWords words, std::uint64_t instances_max, Budget& budget,
             std::string principal, Budget::Lease lease);

    /// Returns the bytes of a view, without what its paths add.
    [[nodiscard]] static std::uint64_t least_bytes(const SceneView& scene,
                                                   const SelectionWords& words);
    /// Makes the view, at the first call. Fails with INVALID_FIELD for a path, instance or object
    /// that the scene lacks, with LIMIT_EXCEEDED where copies of shared objects would have more
    /// than instances_max instances, and with RESOURCE_EXHAUSTED. Takes the time of find_parts().
    Reply<void> make(const Snapshot& scene, const Stop& stop);

    // After make().
    [[nodiscard]] const SceneView& view() const { return instances_->view(); }
    /// Gives hits of the view the objects of the scene.
    void name_by_scene(std::span<HitRecord> hits) const;
    /// Returns what a step in the view is in the scene.
    [[nodiscard]] Step in_scene(Step step) const;
    [[nodiscard]] bool has_copies() const { return instances_->has_copies(); }

    [[nodiscard]] const SelectionWords& words() const { return words_; }
    [[nodiscard]] bool skips_boxes() const { return words_.skips_boxes; }
    /// True once make() has succeeded.
    [[nodiscard]] bool is_made() const { return state_ == State::made; }
    /// True once the last make() has failed.
    [[nodiscard]] bool has_failed() const { return state_ == State::failed; }
    [[nodiscard]] std::uint64_t bytes() const { return bytes_; }

private:
    enum class State : std::uint8_t { unmade, made, failed };

    Reply<void> make_now(const Snapshot& scene, const Stop& stop);

    const SelectionWords words_;
    const std::uint64_t instances_max_;
    Budget& budget_;
    const std::string principal_;
    Budget::Lease lease_;
    std::atomic<std::uint64_t> bytes_;
    std::atomic<State> state_ = State::unmade;
    std::mutex making_;
    std::optional<SelectedInstances> instances_;
};

}  // namespace raynest::server
