#include "server/scheduling/coalescer.h"

#include "server/ground/limited_log.h"

#include <algorithm>
#include <chrono>
#include <exception>
#include <map>
#include <new>
#include <optional>
#include <utility>

namespace raynest::server {
namespace {

/// Maximum rays of a group: fills a traversal's lanes many times, leaves work for other threads.
constexpr std::uint64_t group_rays_max = 1024;

/// Time limit of a common call, a hundred times its usual duration.
constexpr std::chrono::milliseconds group_time_max{20};

using Members = std::vector<DispatchedTaskPointer>;

/// Stops the common call if one of its jobs must stop or the time limit has passed, so that no job
/// waits for another.
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

/// Traces the rays of all members in one call. Returns null, without side effects, on failure.
MergeableTask::AnswerRows trace_together(const Members& members) noexcept {
    try {
        std::vector<const MergeableTask*> tasks;
        for (const auto& member : members) tasks.push_back(member->task.mergeable.get());
        auto rows = tasks.front()->trace(tasks, CommonStop(members));
        return rows ? std::move(*rows) : nullptr;
    } catch (...) {
        return nullptr;  // the members then run alone, and an error fails only its own job
    }
}

void end_one(DispatchedTask& task) {
    try {
        task.done(std::move(task.reply));
    } catch (const std::exception& error) {
        log_limited(LogLevel::error, "handler_failed", "", {{"reason", error.what()}});
    }
}

/// Ends a task that did not run, because its job must stop or memory is short.
void end_unanswered(DispatchedTask& task) {
    task.reply = refuse(task.stop->requested() ? Code::cancelled : Code::resource_exhausted, "");
    end_one(task);
}

}  // namespace

/// Tasks that run together. Owned by a pool thread while its task runs, otherwise by the io thread.
struct Coalescer::Group {
    const Route route;
    const std::string principal;
    const Priority priority;
    Members members;
    std::uint64_t rays = 0;
    std::optional<std::uint64_t> task = {};  ///< number of the group's task in the pool, if any
    bool together = false;                   ///< true: the common call answered all members
    /// Numbers in the pool of members that run alone.
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
            ++route.metrics.tasks_coalesced;
        }
    }

    /// Ends the members after the group's task; on the io thread.
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
            return route.pool.change(principal, separate->second, [] { return false; });
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
            route.pool.change(principal, *task, std::cref(remove));
        else
            remove();
        return removed != nullptr;
    }

private:
    /// Submits a member as a task of its own. Returns false if memory is short.
    bool send_alone(const DispatchedTaskPointer& member) {
        try {
            const auto place = alone.emplace(member.get(), 0).first;
            place->second = dispatch(route.pool, principal, priority, route.post, member);
            return true;
        } catch (const std::bad_alloc&) {
            return false;
        }
    }
};

TryDequeue Coalescer::add(const Route& route, const std::string& principal, Priority priority,
                          DispatchedTaskPointer task) {
    const MergeableTask& mergeable = *task->task.mergeable;
    const auto fits = [&](const std::shared_ptr<Group>& group) {
        return !group->members.empty() && group->principal == principal &&
               group->priority == priority && group->rays + mergeable.rays() <= group_rays_max &&
               group->members.front()->task.mergeable->same_as(mergeable);
    };
    auto group = std::find_if(groups_.begin(), groups_.end(), fits);
    if (group == groups_.end()) {
        auto fresh = std::make_shared<Group>(Group{route, principal, priority, {}});
        fresh->members.reserve(4);
        if (groups_.empty()) route.post([this] { end_turn(); });
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
            group->task = group->route.pool.submit(group->principal, group->priority,
                                                   [group, end = std::move(end)] {
                                                       group->run();
                                                       post_surely(group->route.post, end);
                                                   });
        } catch (const std::bad_alloc&) {
            // Empty the group first: a job that ends looks for its other tasks in it.
            for (const DispatchedTaskPointer& member : std::exchange(group->members, {}))
                end_unanswered(*member);
        }
    }
}

}  // namespace raynest::server
