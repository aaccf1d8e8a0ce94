#include "server/jobs/scene_steps.h"

#include "server/jobs/edit_memory.h"
#include "server/scheduling/fair_thread_pool.h"
#include "server/scheduling/peers.h"
#include "server/store/late_velocities.h"

#include <fmt/format.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <numeric>
#include <ranges>
#include <thread>

namespace raynest::server {
namespace {

/// Steps of one query, at most.
constexpr std::uint64_t sweep_steps_max = 64ULL << 10;

std::uint64_t divided_up(std::uint64_t count, std::uint64_t by) {
    return (count + by - 1) / by;
}

/// Views that are made or in use at once: as many as there are threads to trace in them.
std::size_t views_max() {
    return std::clamp(std::thread::hardware_concurrency(), 2U, 16U);
}

}  // namespace

struct SceneSteps::View {
    std::size_t stretch = 0;
    Budget::Lease lease;
    Budget::Lease selection;
    std::optional<Plan> plan;
    std::uint64_t left = 0;  ///< rays that are not answered
    std::atomic<bool> is_made = false;
    bool is_queued = false;
};

double SceneSteps::seconds_at(std::uint64_t line) const {
    const SweepOrder& sweep = sweep_.order();
    const double time = sweep.time_of(line);
    const double seconds = motion_->seconds ? *motion_->seconds + (time - sweep.begin) : time;
    // Keys are float32, and so is the end (find_moment()).
    return static_cast<double>(static_cast<float>(seconds)) == end_ ? end_ : seconds;
}

void SceneSteps::find_stretches(std::span<const std::uint64_t> edges) {
    const SweepOrder& sweep = sweep_.order();
    for (std::size_t i = 0; i < order_->steps().size(); ++i) {
        const StepOrder::Step& step = order_->steps()[i];
        const std::uint64_t before = step.scan * sweep.lines();
        Stretch stretch{i, i + 1, before + step.begin, before + step.end};
        if (sweep.camera) {
            const auto end = std::ranges::upper_bound(edges, step.scan * order_->grid().channels);
            stretch = {i, i + 1, *std::prev(end), *end};
        }
        if (stretches_.empty() || stretches_.back().begin != stretch.begin)
            stretches_.push_back(stretch);
        else
            stretches_.back().end_step = i + 1;
    }
}

std::span<const StepOrder::Step> SceneSteps::steps_of(std::size_t stretch) const {
    const Stretch& of = stretches_[stretch];
    return order_->steps().subspan(of.first_step, of.end_step - of.first_step);
}

std::size_t SceneSteps::stretch_at(std::uint64_t place) const {
    const auto behind =
        std::ranges::upper_bound(stretches_, order_->step_at(place), {}, &Stretch::first_step);
    return static_cast<std::size_t>(behind - stretches_.begin()) - 1;
}

Reply<std::vector<std::uint64_t>> SceneSteps::find_cuts(double from, double to) const {
    const auto jumps = jumps_between(plan_.scene.snapshot(), motion_->animation, from, to);
    if (!jumps) return refuse(jumps.error());
    std::vector<std::uint64_t> cuts;
    const auto lines = std::views::iota(std::uint64_t{0}, sweep_.order().all_lines());
    for (const double jump : *jumps) {
        // The first line that sees what came of it.
        const std::uint64_t line = *std::ranges::partition_point(
            lines, [&](std::uint64_t l) { return seconds_at(l) < jump; });
        if (line != 0 && (cuts.empty() || cuts.back() != line)) cuts.push_back(line);
    }
    return cuts;
}

Reply<void> SceneSteps::choose(const Stop& stop) {
    const SweepOrder& sweep = sweep_.order();
    const std::uint64_t each = sweep.grid().pixels() / sweep.scans;
    const std::uint64_t first_scan = first_ / each, last_scan = (first_ + count_ - 1) / each;
    std::uint64_t steps = 1;
    std::uint64_t rows = sweep.lines();                  // a camera's, ordered together
    std::vector<std::uint64_t> edges{0, sweep.lines()};  // edges of the camera's stretches
    std::vector<std::uint64_t> cuts;
    if (motion_) {
        end_ = animations_of(plan_.scene.snapshot(), motion_->animation + std::size_t{1})
                   .at(motion_->animation)
                   .seconds;
        // The speed is that of all scans, so that a part has the steps of the whole.
        const double from = seconds_at(0), to = seconds_at(sweep.all_lines() - 1);
        const std::string animation = std::to_string(motion_->animation);
        for (const double end : {from, to})
            if (const auto moment = find_moment(plan_.scene.snapshot(), animation, end); !moment)
                return refuse(moment.error());
        if (!search_) {
            auto search = SpeedSearch::begin(plan_.scene.snapshot(), motion_->animation, from, to);
            if (!search) return refuse(search.error());
            search_.emplace(std::move(*search));
        }
        const auto until = std::chrono::steady_clock::now() + FairThreadPool::slice;
        const bool is_found = search_->go_on(
            [&] { return stop.requested() || std::chrono::steady_clock::now() >= until; });
        if (stop.requested()) return refuse(Code::cancelled, "");
        if (!is_found) return {};  // goes on in its principal's next turn
        const double speed = search_->fastest();
        search_.reset();
        const double error = *sweep.step_error;
        constexpr double rounding = 1e-9;  // the speed's
        const double wanted =
            std::ceil((1 - rounding) * speed * (sweep.end - sweep.begin) / (2 * error));
        if (!std::isnan(wanted))
            steps = static_cast<std::uint64_t>(
                std::clamp(wanted, 1.0, static_cast<double>(sweep.lines())));
        auto found = find_cuts(from, to);
        if (!found) return tl::unexpected(found.error());
        cuts = std::move(*found);
        std::erase_if(cuts, [&](std::uint64_t line) {
            return line / sweep.lines() < first_scan || line / sweep.lines() > last_scan;
        });
        // A camera's steps have whole rows, all of them as many but where parts jump.
        if (sweep.camera) {
            rows = divided_up(rows, divided_up(rows, rows / steps));
            steps = divided_up(sweep.lines(), rows);
            edges = cuts;
            for (std::uint64_t s = 0; s < steps; ++s) edges.push_back(s * rows);
            edges.push_back(sweep.lines());
            std::ranges::sort(edges);
            for (const std::uint64_t cut : cuts) rows = std::gcd(rows, cut);
        }
        const std::uint64_t scans = last_scan - first_scan + 1;
        if (scans + cuts.size() > sweep_steps_max)
            return refuse(
                Code::limit_exceeded,
                fmt::format("parts of the scene jump {} times, and each time begins a step; "
                            "the limit is sweep_steps_max = {}; ask for fewer scans at a "
                            "time",
                            cuts.size(), sweep_steps_max));
        const std::uint64_t most = sweep_steps_max - cuts.size();
        if (steps * scans > most) {
            const double each_most =
                std::floor(static_cast<double>(most) / static_cast<double>(scans));
            return refuse(
                Code::limit_exceeded,
                fmt::format("step_error {:.3g}: parts of the scene move at {:.3g} per second, so "
                            "that it needs {} steps, the limit is sweep_steps_max = {}; accept "
                            "{:.2g} or more, or ask for fewer scans at a time",
                            error, speed, steps * scans + cuts.size(), sweep_steps_max,
                            // Told in two digits, which may be less than it is.
                            1.05 * speed * (sweep.end - sweep.begin) / (2 * each_most)));
        }
        note_ = fmt::format("the scene moved at up to {:.3g} per second, in {} step{} per {}",
                            speed, steps, steps == 1 ? "" : "s", sweep.camera ? "picture" : "scan");
        if (!cuts.empty())
            note_ += fmt::format(", and others where parts of it jump, {} time{}", cuts.size(),
                                 cuts.size() == 1 ? "" : "s");
    } else {
        note_ = "the scene has no animation: it stood still";
    }
    if (sweep.camera) {
        // The rows of a step are a scan of their own, for they lie one behind the other.
        order_.emplace(SweepGrid{sweep.grid().width, rows, divided_up(sweep.lines(), rows)}, first_,
                       count_, 1);
    } else {
        order_.emplace(SweepGrid{sweep.columns, static_cast<std::uint32_t>(sweep.channels.size()),
                                 sweep.scans},
                       first_, count_, steps, cuts);
    }
    find_stretches(edges);
    return {};
}

Task SceneSteps::task_of(std::shared_ptr<View> view) {
    Task task;
    task.run = [this, view = std::move(view)](const Stop& stop) -> Reply<Frames> {
        if (auto made = make(*view, stop); !made) return tl::unexpected(made.error());
        view->is_made = true;
        return Frames{};
    };
    return task;
}

std::optional<Task> SceneSteps::next() {
    if (chosen_ == Chosen::no) {
        chosen_ = Chosen::runs;
        Task task;
        task.run = [this](const Stop& stop) -> Reply<Frames> {
            if (auto chosen = choose(stop); !chosen) return tl::unexpected(chosen.error());
            return Frames{};
        };
        return task;
    }
    if (chosen_ != Chosen::done || next_ == stretches_.size()) return std::nullopt;
    std::size_t used;
    {
        const std::lock_guard lock(mutex_);
        used = views_.size();
    }
    if (used >= views_max()) return std::nullopt;
    const Snapshot& scene = plan_.scene.snapshot();
    const std::uint64_t bytes = motion_ ? 2 * scene.bytes().size() : 0;
    const std::uint64_t hides = plan_.selected != nullptr && motion_
                                    ? Selected::least_bytes(scene.view(), plan_.selected->words())
                                    : 0;
    auto view = std::make_shared<View>();
    auto lease = services_.peers.reserve(bytes, principal_);
    auto selection = services_.peers.reserve(hides, principal_);
    if (!lease || !selection) {
        if (used != 0) return std::nullopt;  // goes on once a view is released
        Task task;
        task.run = [this, bytes = bytes + hides](const Stop&) -> Reply<Frames> {
            return services_.budget.refuse("the scene at another time", bytes, principal_,
                                           "start raynestd with a larger --memory");
        };
        return task;
    }
    view->stretch = next_++;
    view->lease = std::move(*lease);
    view->selection = std::move(*selection);
    for (const StepOrder::Step& step : steps_of(view->stretch)) view->left += step.count;
    {
        const std::lock_guard lock(mutex_);
        views_.emplace(view->stretch, view);
    }
    return task_of(std::move(view));
}

Reply<void> SceneSteps::make(View& view, const Stop& stop) {
    if (stop.requested()) return refuse(Code::cancelled, "");
    view.plan = plan_;
    if (!motion_) return {};
    const Snapshot& scene = plan_.scene.snapshot();
    const Stretch& stretch = stretches_[view.stretch];
    const double seconds = (seconds_at(stretch.begin) + seconds_at(stretch.end - 1)) / 2;
    EditMemory memory(services_.budget, principal_, Use::passing, scene.bytes().size());
    auto posed =
        pose(scene, {motion_->animation, seconds}, memory.guard([&] { return stop.requested(); }));
    view.lease.merge(memory.take());
    if (!posed && stop.requested()) return refuse(Code::cancelled, "");
    if (!posed && memory.refused() != 0)
        return services_.budget.refuse("the scene at another time", memory.refused(), principal_,
                                       "start raynestd with a larger --memory");
    if (!posed) return refuse(std::move(posed.error()));
    auto velocities = std::make_shared<const LateVelocities>(**posed, motion_->animation, seconds);
    view.lease.shrink(std::min<std::uint64_t>(view.lease.bytes(),
                                              (*posed)->bytes().size() + velocities->bytes()));
    view.plan->scene.held = std::make_shared<HeldScene>(
        HeldScene{std::move(*posed), std::move(view.lease), {}, std::move(velocities)});
    if (plan_.selected == nullptr) return {};
    view.plan->selected =
        std::make_shared<Selected>(plan_.selected->words(), services_.limits.hidden_instances_max,
                                   services_.budget, principal_, std::move(view.selection));
    return view.plan->select(stop);
}

void SceneSteps::ended(ChunkQueue& queue) {
    if (chosen_ == Chosen::runs) chosen_ = order_ ? Chosen::done : Chosen::no;
    const std::lock_guard lock(mutex_);
    for (const auto& [number, view] : views_) {
        if (view->is_queued || !view->is_made) continue;
        view->is_queued = true;
        for (const StepOrder::Step& step : steps_of(number)) queue.add(step.first, step.count);
    }
}

std::shared_ptr<const Plan> SceneSteps::plan_of(const Chunk& chunk) const {
    const std::size_t stretch = stretch_at(chunk.first);
    const std::lock_guard lock(mutex_);
    const std::shared_ptr<View>& view = views_.at(stretch);
    return {view, &*view->plan};
}

void SceneSteps::answered(const Chunk& chunk, std::uint64_t count) {
    const std::size_t stretch = stretch_at(chunk.first);
    std::shared_ptr<View> released;  // is freed without the lock
    const std::lock_guard lock(mutex_);
    const auto view = views_.find(stretch);
    view->second->left -= count;
    if (view->second->left != 0) return;
    released = std::move(view->second);
    views_.erase(view);
}

}  // namespace raynest::server
