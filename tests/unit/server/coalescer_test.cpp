// Small tasks with equal questions run together, and fail alone.
#include "server/scheduling/coalescer.h"

#include <doctest/doctest.h>

#include <chrono>
#include <deque>
#include <functional>
#include <memory>
#include <new>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace raynest::server {
namespace {

/// The script of a test's tasks, and a record of their calls.
struct Script {
    std::vector<std::size_t> traced;  ///< tasks of each call
    std::vector<std::uint64_t> rows;  ///< that answers were taken from
    std::vector<std::string> alone;   ///< scenes of tasks that ran by themselves
    bool refuses = false;
    bool throws = false;
    std::function<void()> on_trace = {};
    std::function<void()> on_answer = {};
};

class ScriptedTask final : public MergeableTask {
public:
    ScriptedTask(Script& script, std::string scene, std::uint64_t rays)
        : script_(script),
          scene_(std::move(scene)),
          rays_(rays) {}
    [[nodiscard]] std::uint64_t rays() const override { return rays_; }
    [[nodiscard]] bool same_as(const MergeableTask& other) const override {
        return scene_ == dynamic_cast<const ScriptedTask&>(other).scene_;
    }
    [[nodiscard]] Reply<AnswerRows> trace(std::span<const MergeableTask* const> all,
                                          const Stop& stop) const override {
        if (script_.on_trace) script_.on_trace();
        if (stop.requested()) return refuse(Code::cancelled, "");
        if (script_.throws) throw std::bad_alloc();
        if (script_.refuses) return refuse(Code::internal, "no");
        script_.traced.push_back(all.size());
        return [this](const MergeableTask&, std::uint64_t first_row) -> Reply<Frames> {
            script_.rows.push_back(first_row);
            if (script_.on_answer) script_.on_answer();
            return Frames{};
        };
    }

private:
    Script& script_;
    const std::string scene_;
    const std::uint64_t rays_;
};

struct Turn {
    /// Gives the task, which keeps the reply that its end took.
    DispatchedTaskPointer add(const std::string& scene, std::uint64_t rays,
                              const std::string& principal = "me",
                              Priority priority = Priority::normal) {
        auto task = std::make_shared<DispatchedTask>();
        task->stop = stop = std::make_shared<StopFlag>(Clock::time_point::max());
        task->task.run = [this, scene](const Stop&) -> Reply<Frames> {
            script.alone.push_back(scene);
            return Frames{};
        };
        task->task.mergeable = std::make_shared<ScriptedTask>(script, scene, rays);
        task->reply = refuse(Code::internal, "never ran");
        task->done = [this, at = task.get()](Reply<Frames> reply) {
            ++done;
            at->reply = std::move(reply);
        };
        try_dequeue = coalescer.add({pool, post, metrics}, principal, priority, task);
        return task;
    }
    void run_posted() {
        for (auto next = std::exchange(posted, {}); !next.empty(); next.pop_front()) next.front()();
    }
    /// Runs the end of the turn, the workers and the completions.
    void end() {
        while (pool.run_one()) ++tasks;
        while (!posted.empty()) {
            const std::function<void()> next = std::move(posted.front());
            posted.pop_front();
            next();
            while (pool.run_one()) ++tasks;
        }
    }

    Script script;
    Metrics metrics;
    FairThreadPool pool{0};
    std::deque<std::function<void()>> posted;
    const Post post = [this](std::function<void()> f) { posted.push_back(std::move(f)); };
    std::shared_ptr<StopFlag> stop;  ///< the last one's
    TryDequeue try_dequeue;          ///< the last one's
    int tasks = 0;
    int done = 0;
    Coalescer coalescer;
};

TEST_CASE("equal questions of one turn are one task and one call") {
    Turn turn;
    std::vector<DispatchedTaskPointer> tasks;
    for (const std::uint64_t rays : {3U, 5U, 7U}) tasks.push_back(turn.add("woods", rays));
    CHECK(turn.posted.size() == 1);
    turn.end();
    CHECK(turn.tasks == 1);
    CHECK(turn.script.traced == std::vector<std::size_t>{3});
    CHECK(turn.script.rows == std::vector<std::uint64_t>{0, 3, 8});
    CHECK(turn.script.alone.empty());
    for (const auto& task : tasks) CHECK(task->reply.has_value());
    CHECK(turn.done == 3);
    CHECK(turn.metrics.tasks_coalesced == 3);
    // The next turn has its own task.
    turn.add("woods", 1);
    turn.end();
    CHECK(turn.script.traced.size() == 1);
    CHECK(turn.script.alone == std::vector<std::string>{"woods"});
    CHECK(turn.done == 4);
}

TEST_CASE("other questions, principals and priorities have groups of their own") {
    Turn turn;
    for (int i = 0; i < 2; ++i) {
        turn.add("woods", 1);
        turn.add("hills", 1);
        turn.add("woods", 1, "you");
        turn.add("woods", 1, "me", Priority::high);
    }
    turn.end();
    CHECK(turn.tasks == 4);
    CHECK(turn.script.traced == std::vector<std::size_t>{2, 2, 2, 2});
}

TEST_CASE("a group has a limit") {
    Turn turn;
    for (int i = 0; i < 9; ++i) turn.add("woods", 250);
    turn.end();
    CHECK(turn.script.traced == std::vector<std::size_t>{4, 4});
    CHECK(turn.script.alone.size() == 1);
    CHECK(turn.done == 9);
}

TEST_CASE("when the common call fails each task runs alone") {
    Turn turn;
    SUBCASE("by an error") {
        turn.script.refuses = true;
    }
    SUBCASE("by an exception") {
        turn.script.throws = true;
    }
    const auto first = turn.add("woods", 1);
    const auto second = turn.add("woods", 1);
    turn.end();
    CHECK(turn.script.alone.size() == 2);
    CHECK(turn.script.rows.empty());
    CHECK(first->reply.has_value());
    CHECK(second->reply.has_value());
    CHECK(turn.done == 2);
    CHECK(turn.metrics.tasks_coalesced == 0);
}

TEST_CASE("when the common call fails each has a task of its own") {
    Turn turn;
    turn.script.refuses = true;
    turn.add("woods", 1);
    turn.add("woods", 1);
    turn.add("woods", 1);
    const TryDequeue try_dequeue = turn.try_dequeue;
    turn.run_posted();
    CHECK(turn.pool.run_one());  // the common call
    CHECK(turn.script.alone.empty());
    CHECK_FALSE(try_dequeue());  // done, but its end is still on its way
    turn.run_posted();
    CHECK(turn.pool.run_one());
    turn.run_posted();
    CHECK(turn.done == 1);  // and not when all are
    CHECK(try_dequeue());
    CHECK_FALSE(try_dequeue());
    CHECK(turn.pool.run_one());
    CHECK_FALSE(turn.pool.run_one());
    turn.run_posted();
    CHECK(turn.done == 2);
    CHECK(turn.script.alone.size() == 2);
}

TEST_CASE("a waiting task can be withdrawn, alone or from a group, and never runs") {
    Turn turn;
    turn.add("woods", 1);
    const TryDequeue first = turn.try_dequeue;
    turn.add("hills", 1);
    const TryDequeue only = turn.try_dequeue;
    turn.add("woods", 1);
    turn.add("woods", 1);
    const TryDequeue last = turn.try_dequeue;
    SUBCASE("before the end of the turn") {}
    SUBCASE("in the workers' queue") {
        turn.run_posted();
    }
    CHECK(first());
    CHECK_FALSE(first());
    CHECK(only());
    CHECK(last());
    turn.end();
    CHECK(turn.tasks == 1);
    CHECK(turn.script.traced.empty());
    CHECK(turn.script.alone == std::vector<std::string>{"woods"});
    CHECK(turn.done == 1);
    CHECK_FALSE(first());
}

TEST_CASE("a slow member of a group delays no one") {
    Turn turn;
    // Keep it running for as long as it is wanted.
    turn.script.on_trace = [] { std::this_thread::sleep_for(std::chrono::milliseconds(50)); };
    turn.add("woods", 4);
    turn.add("woods", 4);
    turn.end();
    CHECK(turn.script.traced.empty());
    CHECK(turn.script.alone.size() == 2);
    CHECK(turn.done == 2);
}

TEST_CASE("a cancelled member is refused, and the others are answered") {
    Turn turn;
    const auto first = turn.add("woods", 4);
    const auto cancelled = turn.add("woods", 4);
    const std::shared_ptr<StopFlag> stop = turn.stop;
    const auto last = turn.add("woods", 4);
    SUBCASE("before its turn: each of the others runs alone") {
        stop->request();
        turn.end();
        CHECK(turn.script.alone.size() == 2);
        CHECK(turn.script.rows.empty());
    }
    SUBCASE("while all are traced: the same") {
        turn.script.on_trace = [&] { stop->request(); };
        turn.end();
        CHECK(turn.script.alone.size() == 2);
        CHECK(turn.script.rows.empty());
    }
    SUBCASE("once they are traced: the others are answered from their own rows") {
        turn.script.on_answer = [&] { stop->request(); };
        turn.end();
        CHECK(turn.script.alone.empty());
        CHECK(turn.script.rows == std::vector<std::uint64_t>{0, 8});
    }
    CHECK(first->reply.has_value());
    REQUIRE_FALSE(cancelled->reply.has_value());
    CHECK(cancelled->reply.error().code == Code::cancelled);
    CHECK(last->reply.has_value());
}

}  // namespace
}  // namespace raynest::server
