#include "server/jobs/coalescer.h"

#include "server/log.h"

#include <algorithm>
#include <chrono>
#include <exception>
#include <functional>
#include <map>
#include <new>
#include <optional>
#include <span>
#include <utility>

namespace raynest::server {
namespace {

/// Enough to fill a traversal's lanes many times; few enough to leave work for other threads.
constexpr std::uint64_t group_rays_max = 1024;

/// Of a common call; a hundred times what it usually takes.
constexpr std::chrono::milliseconds group_time_max{20};

/// Of several jobs: none waits for another one that must end, or that takes long.
class CommonStop final : public Stop {
public:
    explicit CommonStop(std::span<const Errand> errands) : errands_(errands) {}
    [[nodiscard]] bool requested() const noexcept override {
        return Clock::now() >= end_ ||
               std::any_of(errands_.begin(), errands_.end(),
                           [](const Errand& errand) { return errand.stop->requested(); });
    }

private:
    const std::span<const Errand> errands_;
    const Clock::time_point end_ = Clock::now() + group_time_max;
};

/// Traces the rays of all at once; false, and nothing has happened, when that fails.
bool trace_together(std::span<const Errand> errands) noexcept {
    try {
        std::vector<const Question*> questions;
        for (const Errand& errand : errands) questions.push_back(errand.task.question.get());
        return questions.front()->trace(questions, CommonStop(errands)).has_value();
    } catch (...) {
        return false;  // each alone: what is wrong fails its own job only
    }
}

void finish(const Errand& errand) {
    try {
        errand.done();
    } catch (const std::exception& error) {
        log(LogLevel::error, "handler_failed", {{"reason", error.what()}});
    }
}

/// Without a task: its job must end, or there is no memory for one.
void finish_unanswered(const Errand& errand) {
    const bool stopped = errand.stop->requested();
    *errand.reply = refuse(stopped ? Code::cancelled : Code::resource_exhausted, "");
    finish(errand);
}

/// Of an errand, whatever becomes of it.
using Identity = const Reply<Frames>*;

}  // namespace

/// A worker has it from when its task is begun until that is done, else the io thread.
struct Coalescer::Group {
    const Way way;
    const std::string principal;
    const Priority priority;
    std::vector<Errand> errands;
    std::uint64_t rays = 0;
    std::optional<std::uint64_t> task = {};        ///< number of its task, once it has one
    bool together = false;                         ///< its task answered all
    std::map<Identity, std::uint64_t> alone = {};  ///< numbers of their own tasks, once they have

    void run() noexcept {
        if (errands.size() == 1) {
            errands.front().run();
            together = true;
            return;
        }
        together = trace_together(errands);
        std::uint64_t row = 0;
        for (const Errand& errand : errands) {
            if (!together) break;
            const Question& question = *errand.task.question;
            *errand.reply = run_guarded(*errand.stop, [&] { return question.answer(row); });
            row += question.rays();
            ++way.metrics.tasks_coalesced;
        }
    }

    /// Its task is done.
    void end() {
        std::vector<Errand> members = std::move(errands);
        errands.clear();
        for (Errand& errand : members) {
            if (together)
                finish(errand);
            else if (errand.stop->requested() || !send_alone(errand))
                finish_unanswered(errand);
        }
    }

    bool withdraw(Identity identity) {
        const auto separate = alone.find(identity);
        if (separate != alone.end())
            return way.workers.change(principal, separate->second, [] { return false; });
        std::optional<Errand> withdrawn;
        const auto remove = [&] {
            const auto member =
                std::find_if(errands.begin(), errands.end(),
                             [&](const Errand& errand) { return errand.reply.get() == identity; });
            if (member != errands.end()) {
                withdrawn = std::move(*member);
                errands.erase(member);
            }
            return !errands.empty();
        };
        if (task)
            way.workers.change(principal, *task, std::cref(remove));
        else
            remove();
        return withdrawn.has_value();
    }

private:
    /// False, and it is still here, without memory for its task.
    bool send_alone(Errand& errand) {
        std::shared_ptr<Errand> moved;
        try {
            const auto place = alone.emplace(errand.reply.get(), 0).first;
            moved = std::make_shared<Errand>(std::move(errand));
            place->second = way.workers.submit(principal, priority, [moved, &post = way.post] {
                moved->run();
                post_surely(post, moved->done);
            });
            return true;
        } catch (const std::bad_alloc&) {
            if (moved != nullptr) errand = std::move(*moved);
            return false;
        }
    }
};

Withdraw Coalescer::add(const Way& way, const std::string& principal, Priority priority,
                        Errand errand) {
    const Question& question = *errand.task.question;
    const auto fits = [&](const std::shared_ptr<Group>& group) {
        return !group->errands.empty() && group->principal == principal &&
               group->priority == priority && group->rays + question.rays() <= group_rays_max &&
               group->errands.front().task.question->same_as(question);
    };
    auto group = std::find_if(groups_.begin(), groups_.end(), fits);
    if (group == groups_.end()) {
        auto fresh = std::make_shared<Group>(Group{way, principal, priority, {}});
        fresh->errands.reserve(4);
        if (groups_.empty()) way.post([this] { end_turn(); });
        group = groups_.insert(groups_.end(), std::move(fresh));
    }
    Withdraw withdraw = [group = *group, identity = errand.reply.get()] {
        return group->withdraw(identity);
    };
    (*group)->rays += question.rays();
    (*group)->errands.push_back(std::move(errand));
    return withdraw;
}

void Coalescer::end_turn() {
    const std::vector<std::shared_ptr<Group>> groups = std::exchange(groups_, {});
    for (const std::shared_ptr<Group>& group : groups) {
        if (group->errands.empty()) continue;
        try {
            std::function<void()> done = [group] { group->end(); };
            group->task = group->way.workers.submit(group->principal, group->priority,
                                                    [group, done = std::move(done)] {
                                                        group->run();
                                                        post_surely(group->way.post, done);
                                                    });
        } catch (const std::bad_alloc&) {
            // Out of the group, where a job that ends would look for its others.
            const std::vector<Errand> members = std::move(group->errands);
            group->errands.clear();
            for (const Errand& errand : members) finish_unanswered(errand);
        }
    }
}

}  // namespace raynest::server
