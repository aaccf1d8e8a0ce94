#include "server/jobs/coalescer.h"

#include "server/log.h"

#include <algorithm>
#include <exception>
#include <new>
#include <span>
#include <utility>

namespace raynest::server {
namespace {

/// Enough to fill a traversal's lanes many times; few enough to leave work for other threads.
constexpr std::uint64_t group_rays_max = 1024;

/// Of several jobs: one that must end keeps no other waiting, each then runs alone.
class StopOfAny final : public Stop {
public:
    explicit StopOfAny(std::span<const Errand> errands) : errands_(errands) {}
    [[nodiscard]] bool requested() const noexcept override {
        return std::any_of(errands_.begin(), errands_.end(),
                           [](const Errand& errand) { return errand.stop->requested(); });
    }

private:
    const std::span<const Errand> errands_;
};

/// Traces the rays of all at once; false, and nothing has happened, when that fails.
bool trace_together(std::span<const Errand> errands) noexcept {
    if (errands.size() < 2) return false;
    try {
        std::vector<const Question*> questions;
        for (const Errand& errand : errands) questions.push_back(errand.task.question.get());
        return questions.front()->trace(questions, StopOfAny(errands)).has_value();
    } catch (...) {
        return false;  // each alone: what is wrong fails its own job only
    }
}

}  // namespace

void Coalescer::add(const Way& way, const std::string& principal, Priority priority,
                    Errand errand) {
    const Question& question = *errand.task.question;
    const auto fits = [&](const std::shared_ptr<Group>& group) {
        return group->principal == principal && group->priority == priority &&
               group->rays + question.rays() <= group_rays_max &&
               group->errands.front().task.question->same_as(question);
    };
    auto group = std::find_if(groups_.begin(), groups_.end(), fits);
    if (group == groups_.end()) {
        if (groups_.empty()) way.post([this, way] { end_turn(way); });
        auto fresh = std::make_shared<Group>(Group{principal, priority, {}, 0});
        fresh->errands.reserve(4);
        group = groups_.insert(groups_.end(), std::move(fresh));
    }
    (*group)->errands.push_back(std::move(errand));
    (*group)->rays += question.rays();
}

void Coalescer::end_turn(const Way& way) {
    const std::vector<std::shared_ptr<Group>> groups = std::exchange(groups_, {});
    for (const std::shared_ptr<Group>& group : groups) {
        try {
            std::function<void()> done = [group] { finish(*group); };
            way.workers.submit(
                group->principal, group->priority,
                [group, done = std::move(done), &post = way.post, &metrics = way.metrics] {
                    run(*group, metrics);
                    post_surely(post, done);
                });
        } catch (const std::bad_alloc&) {
            run(*group, way.metrics);
            finish(*group);
        }
    }
}

void Coalescer::run(const Group& group, Metrics& metrics) noexcept {
    // Those that must end are refused in their turn.
    const bool together = trace_together(group.errands);
    std::uint64_t row = 0;
    for (const Errand& errand : group.errands) {
        if (!together) {
            errand.run();
            continue;
        }
        const Question& question = *errand.task.question;
        *errand.reply = run_guarded(*errand.stop, [&] { return question.answer(row); });
        row += question.rays();
        ++metrics.tasks_coalesced;
    }
}

void Coalescer::finish(const Group& group) {
    for (const Errand& errand : group.errands) {
        try {
            errand.done();
        } catch (const std::exception& error) {
            log(LogLevel::error, "handler_failed", {{"reason", error.what()}});
        }
    }
}

}  // namespace raynest::server
