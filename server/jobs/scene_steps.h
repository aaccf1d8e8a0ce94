// A scene that moves while a sweep is measured: it stands still within each of many steps.
//
//   speed, accepted error ──► StepOrder ──► a view of the scene for each step, made in a task and
//                                           released with the last ray of the step
#pragma once

#include "engine/scene/edits/pose.h"
#include "engine/scene/edits/speed.h"
#include "server/execution/chunk_queue.h"
#include "server/execution/plan.h"
#include "server/execution/step_order.h"
#include "server/jobs/ray_source.h"
#include "server/jobs/services.h"

#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

namespace raynest::server {

/// The steps of one query. Functions are called on the io thread where none says otherwise.
class SceneSteps {
public:
    /// Steps for rays [first, first + count) of `sweep`. `plan` is that of the scene as it was loaded and
    /// edited; both outlive this. Without a motion the scene stands still, in one step per scan.
    SceneSteps(const Services& services, const Plan& plan, const SentSweep& sweep,
               const std::optional<SceneMotion>& motion, std::uint64_t first, std::uint64_t count,
               std::string principal)
        : services_(services),
          plan_(plan),
          sweep_(sweep),
          motion_(motion),
          first_(first),
          count_(count),
          principal_(std::move(principal)) {}

    /// Returns the next task of those that make views: the first ones choose the steps. Nothing
    /// while as many views are in use as may be.
    std::optional<Task> next();
    /// Called when a task has ended. Adds the places of steps whose view is made.
    void ended(ChunkQueue& queue);

    /// True once order() is known.
    [[nodiscard]] bool is_chosen() const { return chosen_ == Chosen::done; }

    // Any thread, once a place is in the queue:

    [[nodiscard]] const StepOrder& order() const { return *order_; }
    /// The plan of a chunk, which lies within a step.
    [[nodiscard]] std::shared_ptr<const Plan> plan_of(const Chunk& chunk) const;
    /// Releases the view of a step whose last ray is answered.
    void answered(const Chunk& chunk, std::uint64_t count);
    /// A line for the user, after the last chunk.
    [[nodiscard]] const std::string& note() const { return note_; }

private:
    struct View;
    /// A part of the sweep that sees the scene at one moment: a step of the order, of a camera one or several.
    struct Stretch {
        std::size_t first_step, end_step;  ///< steps of the order
        std::uint64_t begin, end;          ///< lines, those of a whole sweep
    };

    Reply<void> choose(const Stop& stop);
    Reply<void> make(View& view, const Stop& stop);
    [[nodiscard]] double seconds_at(std::uint64_t line) const;
    /// Lines where a step must begin because parts of the scene jump there, ascending.
    [[nodiscard]] Reply<std::vector<std::uint64_t>> find_cuts(double from, double to) const;
    /// Chooses the stretches; `edges` are lines where those of a camera begin and the last one ends.
    void find_stretches(std::span<const std::uint64_t> edges);
    [[nodiscard]] std::span<const StepOrder::Step> steps_of(std::size_t stretch) const;
    /// The stretch of a place. Any thread.
    [[nodiscard]] std::size_t stretch_at(std::uint64_t place) const;
    [[nodiscard]] Task task_of(std::shared_ptr<View> view);

    const Services& services_;
    const Plan& plan_;
    const SentSweep& sweep_;
    const std::optional<SceneMotion> motion_;
    const std::uint64_t first_, count_;
    const std::string principal_;
    enum class Chosen { no, runs, done } chosen_ = Chosen::no;
    std::optional<SpeedSearch> search_;  ///< for the first tasks, which follow each other
    std::optional<StepOrder> order_;     ///< written by the last one of them
    std::string note_;                   ///< likewise
    double end_ = 0;                     ///< the animation's end; likewise
    std::vector<Stretch> stretches_;     ///< likewise
    std::size_t next_ = 0;               ///< the next among them
    mutable std::mutex mutex_;
    std::map<std::size_t, std::shared_ptr<View>> views_;  ///< by stretch: those in use
};

}  // namespace raynest::server
