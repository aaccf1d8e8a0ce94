// Small tasks that ask the same run together, and fail alone.
#include "server/jobs/coalescer.h"

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

/// What the questions of a test see and do.
struct Script {
    std::vector<std::size_t> traced;  ///< questions of each call
    std::vector<std::uint64_t> rows;  ///< that answers were taken from
    std::vector<std::string> alone;   ///< scenes of tasks that ran by themselves
    bool refuses = false;
    bool throws = false;
    std::function<void()> on_trace = {};
    std::function<void()> on_answer = {};
};

class ScriptedQuestion final : public Question {
public:
    ScriptedQuestion(Script& script, std::string scene, std::uint64_t rays)
        : script_(script),
          scene_(std::move(scene)),
          rays_(rays) {}
    [[nodiscard]] std::uint64_t rays() const override { return rays_; }
    [[nodiscard]] bool same_as(const Question& other) const override {
        return scene_ == dynamic_cast<const ScriptedQuestion&>(other).scene_;
    }
    [[nodiscard]] Reply<void> trace(std::span<const Question* const> all,
                                    const Stop& stop) const override {
        if (script_.on_trace) script_.on_trace();
        if (stop.requested()) return refuse(Code::cancelled, "");
        if (script_.throws) throw std::bad_alloc();
        if (script_.refuses) return refuse(Code::internal, "no");
        script_.traced.push_back(all.size());
        return {};
    }
    [[nodiscard]] Reply<Frames> answer(std::uint64_t first_row) const override {
        script_.rows.push_back(first_row);
        if (script_.on_answer) script_.on_answer();
        return Frames{};
    }

private:
    Script& script_;
    const std::string scene_;
    const std::uint64_t rays_;
};

struct Turn {
    /// Gives where its reply will be.
    std::shared_ptr<Reply<Frames>> add(const std::string& scene, std::uint64_t rays,
                                       const std::string& principal = "me",
                                       Priority priority = Priority::normal) {
        Errand errand;
        errand.stop = stop = std::make_shared<StopFlag>(Clock::time_point::max());
        errand.task.run = [this, scene](const Stop&) -> Reply<Frames> {
            script.alone.push_back(scene);
            return Frames{};
        };
        errand.task.question = std::make_shared<ScriptedQuestion>(script, scene, rays);
        errand.reply = std::make_shared<Reply<Frames>>(refuse(Code::internal, "never ran"));
        errand.done = [this] { ++done; };
        auto reply = errand.reply;
        withdraw =
            coalescer.add({workers, post, metrics}, principal, priority, std::move(errand));
        return reply;
    }
    void run_posted() {
        for (auto next = std::exchange(posted, {}); !next.empty(); next.pop_front()) next.front()();
    }
    /// The end of the turn, the workers, the way back.
    void end() {
        while (workers.run_one()) ++tasks;
        while (!posted.empty()) {
            const std::function<void()> next = std::move(posted.front());
            posted.pop_front();
            next();
            while (workers.run_one()) ++tasks;
        }
    }

    Script script;
    Metrics metrics;
    Workers workers{0};
    std::deque<std::function<void()>> posted;
    const Post post = [this](std::function<void()> f) { posted.push_back(std::move(f)); };
    std::shared_ptr<StopFlag> stop;  ///< of the last one
    Withdraw withdraw;               ///< of the last one
    int tasks = 0;
    int done = 0;
    Coalescer coalescer;
};

TEST_CASE("what asks the same in one turn is one task and one call") {
    Turn turn;
    std::vector<std::shared_ptr<Reply<Frames>>> replies;
    for (const std::uint64_t rays : {3U, 5U, 7U}) replies.push_back(turn.add("woods", rays));
    CHECK(turn.posted.size() == 1);
    turn.end();
    CHECK(turn.tasks == 1);
    CHECK(turn.script.traced == std::vector<std::size_t>{3});
    CHECK(turn.script.rows == std::vector<std::uint64_t>{0, 3, 8});
    CHECK(turn.script.alone.empty());
    for (const auto& reply : replies) CHECK(reply->has_value());
    CHECK(turn.done == 3);
    CHECK(turn.metrics.tasks_coalesced == 3);
    // The next turn has its own.
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

TEST_CASE("a group has an end") {
    Turn turn;
    for (int i = 0; i < 9; ++i) turn.add("woods", 250);
    turn.end();
    CHECK(turn.script.traced == std::vector<std::size_t>{4, 4});
    CHECK(turn.script.alone.size() == 1);
    CHECK(turn.done == 9);
}

TEST_CASE("when the common call fails each runs alone") {
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
    CHECK(first->has_value());
    CHECK(second->has_value());
    CHECK(turn.done == 2);
    CHECK(turn.metrics.tasks_coalesced == 0);
}

TEST_CASE("when the common call fails each has a task of its own") {
    Turn turn;
    turn.script.refuses = true;
    turn.add("woods", 1);
    turn.add("woods", 1);
    turn.add("woods", 1);
    const Withdraw withdraw = turn.withdraw;
    turn.run_posted();
    CHECK(turn.workers.run_one());  // the common call
    CHECK(turn.script.alone.empty());
    CHECK_FALSE(withdraw());  // done, but its end is still on its way
    turn.run_posted();
    CHECK(turn.workers.run_one());
    turn.run_posted();
    CHECK(turn.done == 1);  // and not when all are
    CHECK(withdraw());
    CHECK_FALSE(withdraw());
    CHECK(turn.workers.run_one());
    CHECK_FALSE(turn.workers.run_one());
    turn.run_posted();
    CHECK(turn.done == 2);
    CHECK(turn.script.alone.size() == 2);
}

TEST_CASE("one is taken back while it waits, alone or among others, and never runs") {
    Turn turn;
    turn.add("woods", 1);
    const Withdraw first = turn.withdraw;
    turn.add("hills", 1);
    const Withdraw only = turn.withdraw;
    turn.add("woods", 1);
    turn.add("woods", 1);
    const Withdraw last = turn.withdraw;
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

TEST_CASE("nobody waits for a member that takes long") {
    Turn turn;
    // As long as it is wanted.
    turn.script.on_trace = [] { std::this_thread::sleep_for(std::chrono::milliseconds(50)); };
    turn.add("woods", 4);
    turn.add("woods", 4);
    turn.end();
    CHECK(turn.script.traced.empty());
    CHECK(turn.script.alone.size() == 2);
    CHECK(turn.done == 2);
}

TEST_CASE("a cancelled one is refused, and the others are answered") {
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
    CHECK(first->has_value());
    REQUIRE_FALSE(cancelled->has_value());
    CHECK(cancelled->error().code == Code::cancelled);
    CHECK(last->has_value());
}

}  // namespace
}  // namespace raynest::server
