#include "server/jobs/coalescer.h"

#include "server/log.h"

#include <algorithm>
#include <chrono>
#include <exception>
#include <functional>
#include <map>
#include <new>
#include <optional>
#include <utility>

namespace raynest::server {
namespace {

/// Enough to fill a traversal's lanes many times; few enough to leave work for other threads.
constexpr std::uint64_t group_rays_max = 1024;

/// Time of a common call at most; a hundred times what it usually takes.
constexpr std::chrono::milliseconds group_time_max{20};

using Members = std::vector<DispatchedTaskPointer>;

/// Ends the common call of several jobs: none waits for another one that must end, or that takes
/// long.
class CommonStop final : public Stop {
public:
    explicit CommonStop(const Members& members) : members_(members) {}
    [[nodiscard]] bool requested() const noexcept override {
        return Clock::now() >= end_ ||
               std::any_of(members_.begin(), members_.end(),
                           [](const auto& member) { return member->stop->requested(); });
    }

private:
    const Members& members_;
    const Clock::time_point end_ = Clock::now() + group_time_max;
};

/// Traces the rays of all at once; null, and nothing has happened, when that fails.
MergeableTask::AnswerRows trace_together(const Members& members) noexcept {
    try {
        std::vector<const MergeableTask*> tasks;
        for (const auto& member : members) tasks.push_back(member->task.mergeable.get());
        auto rows = tasks.front()->trace(tasks, CommonStop(members));
        return rows ? std::move(*rows) : nullptr;
    } catch (...) {
        return nullptr;  // each alone: what is wrong fails its own job only
    }
}

void end_one(DispatchedTask& task) {
    try {
        task.done(std::move(task.reply));
    } catch (const std::exception& error) {
        log(LogLevel::error, "handler_failed", {{"reason", error.what()}});
    }
}

/// Ends a task that did not run: its job must end, or there is no memory for it.
void end_unanswered(DispatchedTask& task) {
    task.reply = refuse(task.stop->requested() ? Code::cancelled : Code::resource_exhausted, "");
    end_one(task);
}

}  // namespace

/// A thread has it from when its task is begun until that is done, else the io thread.
struct Coalescer::Group {
    const Way way;
    const std::string principal;
    const Priority priority;
    Members members;
    std::uint64_t rays = 0;
    std::optional<std::uint64_t> task = {};  ///< number of its task, once it has one
    bool together = false;                   ///< its task answered all
    /// Numbers of the members' own tasks, once they have some.
    std::map<const DispatchedTask*, std::uint64_t> alone = {};

    void run() noexcept {
        if (members.size() == 1) {
            members.front()->run();
            together = true;
            return;
        }
        const auto answer_rows = trace_together(members);
        together = answer_rows != nullptr;
        std::uint64_t row = 0;
        for (const DispatchedTaskPointer& member : members) {
            if (!together) break;
            const MergeableTask& merged = *member->task.mergeable;
            member->reply = run_guarded(*member->stop, [&] { return answer_rows(merged, row); });
            row += merged.rays();
            ++way.metrics.tasks_coalesced;
        }
    }

    /// Its task is done.
    void end() {
        for (const DispatchedTaskPointer& member : std::exchange(members, {})) {
            if (together)
                end_one(*member);
            else if (member->stop->requested() || !send_alone(member))
                end_unanswered(*member);
        }
    }

    bool try_dequeue(const DispatchedTask* member) {
        const auto separate = alone.find(member);
        if (separate != alone.end())
            return way.pool.change(principal, separate->second, [] { return false; });
        DispatchedTaskPointer removed;
        const auto remove = [&] {
            const auto found = std::find_if(members.begin(), members.end(),
                                            [&](const auto& each) { return each.get() == member; });
            if (found != members.end()) {
                removed = std::move(*found);
                members.erase(found);
            }
            return !members.empty();
        };
        if (task)
            way.pool.change(principal, *task, std::cref(remove));
        else
            remove();
        return removed != nullptr;
    }

private:
    /// False without memory for its task.
    bool send_alone(const DispatchedTaskPointer& member) {
        try {
            const auto place = alone.emplace(member.get(), 0).first;
            place->second = dispatch(way.pool, principal, priority, way.post, member);
            return true;
        } catch (const std::bad_alloc&) {
            return false;
        }
    }
};

TryDequeue Coalescer::add(const Way& way, const std::string& principal, Priority priority,
                          DispatchedTaskPointer task) {
    const MergeableTask& mergeable = *task->task.mergeable;
    const auto fits = [&](const std::shared_ptr<Group>& group) {
        return !group->members.empty() && group->principal == principal &&
               group->priority == priority && group->rays + mergeable.rays() <= group_rays_max &&
               group->members.front()->task.mergeable->same_as(mergeable);
    };
    auto group = std::find_if(groups_.begin(), groups_.end(), fits);
    if (group == groups_.end()) {
        auto fresh = std::make_shared<Group>(Group{way, principal, priority, {}});
        fresh->members.reserve(4);
        if (groups_.empty()) way.post([this] { end_turn(); });
        group = groups_.insert(groups_.end(), std::move(fresh));
    }
    TryDequeue try_dequeue = [group = *group, member = task.get()] {
        return group->try_dequeue(member);
    };
    (*group)->rays += mergeable.rays();
    (*group)->members.push_back(std::move(task));
    return try_dequeue;
}

void Coalescer::end_turn() {
    for (const std::shared_ptr<Group>& group : std::exchange(groups_, {})) {
        if (group->members.empty()) continue;
        try {
            std::function<void()> end = [group] { group->end(); };
            group->task = group->way.pool.submit(group->principal, group->priority,
                                                 [group, end = std::move(end)] {
                                                     group->run();
                                                     post_surely(group->way.post, end);
                                                 });
        } catch (const std::bad_alloc&) {
            // Out of the group, where a job that ends would look for its others.
            for (const DispatchedTaskPointer& member : std::exchange(group->members, {}))
                end_unanswered(*member);
        }
    }
}

}  // namespace raynest::server
