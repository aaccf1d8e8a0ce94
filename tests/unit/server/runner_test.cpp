// Tests the runner with scripted jobs and a sink in memory: frames to the client, and their order.
#include "server/scheduling/runner.h"

#include "tests/unit/server/bench.h"

#include <doctest/doctest.h>

#include <limits>
#include <new>
#include <stdexcept>
#include <thread>

namespace raynest::server {
namespace {

using std::chrono::seconds;

TEST_CASE("a job answers all its tasks, then ends") {
    Bench bench;
    REQUIRE(bench.runner->start(1, accept(std::make_unique<ScriptedJob>(50, 1000))));
    REQUIRE(bench.run_until_idle());
    CHECK(bench.count(wire::Message::Chunk) == 50);
    CHECK(bench.sent.back().header.type == static_cast<std::uint16_t>(wire::Message::Done));
    CHECK(bench.metrics.jobs_ended == 1);
}

/// Tasks of `hits` rays each that record the thread they run on.
class BriefJob final : public Job {
public:
    BriefJob(int tasks, std::uint64_t hits, std::vector<std::thread::id>& ran)
        : tasks_(tasks),
          hits_(hits),
          ran_(ran) {}
    std::optional<Task> next() override {
        if (tasks_ == 0) return std::nullopt;
        --tasks_;
        Task task;
        task.inline_cost = hits_;
        task.run = [this](const Stop&) {
            ran_.push_back(std::this_thread::get_id());
            return Reply<Frames>();
        };
        return task;
    }
    [[nodiscard]] bool finished() const override { return tasks_ == 0; }
    Frames farewell() override { return {}; }

private:
    int tasks_;
    const std::uint64_t hits_;
    std::vector<std::thread::id>& ran_;
};

TEST_CASE("a brief task is answered on the io thread, a longer one by a worker") {
    Bench bench;
    const std::thread::id here = std::this_thread::get_id();
    std::vector<std::thread::id> ran;
    REQUIRE(bench.runner->start(1, accept(std::make_unique<BriefJob>(3, 1, ran))));
    CHECK(ran == std::vector<std::thread::id>(3, here));
    CHECK(bench.runner->size() == 0);
    CHECK(bench.admission.active() == 0);

    ran.clear();
    REQUIRE(bench.runner->start(2, accept(std::make_unique<BriefJob>(1, 0, ran))));
    REQUIRE(bench.run_until_idle());
    REQUIRE(ran.size() == 1);
    CHECK(ran[0] != here);
}

TEST_CASE("the io thread answers only a turn's share of many simultaneous small requests") {
    Bench bench;
    const std::thread::id here = std::this_thread::get_id();
    std::vector<std::thread::id> first;
    std::vector<std::thread::id> second;
    REQUIRE(bench.runner->start(1, accept(std::make_unique<BriefJob>(1, 40, first))));
    CHECK(first == std::vector<std::thread::id>{here});
    REQUIRE(bench.runner->start(2, accept(std::make_unique<BriefJob>(1, 40, second))));
    CHECK(bench.admission.active() == 1);
    // The end of the turn was posted before the worker's answer could be.
    REQUIRE(bench.run_until_idle());
    REQUIRE(second.size() == 1);
    CHECK(second[0] != here);
    REQUIRE(bench.runner->start(3, accept(std::make_unique<BriefJob>(1, 40, first))));
    CHECK(first == std::vector<std::thread::id>{here, here});
}

/// A task that runs for ever on the io thread, but returns at once on a worker.
class SlowerThanItLooks final : public Job {
public:
    explicit SlowerThanItLooks(std::vector<std::thread::id>& ran) : ran_(ran) {}
    std::optional<Task> next() override {
        if (std::exchange(given_, true)) return std::nullopt;
        Task task;
        task.inline_cost = 1;
        task.run = [this, io = std::this_thread::get_id()](const Stop& stop) -> Reply<Frames> {
            ran_.push_back(std::this_thread::get_id());
            if (ran_.back() != io) return Frames{};
            while (!stop.requested()) std::this_thread::yield();
            return refuse(Code::cancelled, "");
        };
        return task;
    }
    [[nodiscard]] bool finished() const override { return given_; }
    Frames farewell() override { return {}; }

private:
    bool given_ = false;
    std::vector<std::thread::id>& ran_;
};

TEST_CASE("a brief task that takes long goes to a worker, and the rest of the turn with it") {
    Bench bench;
    const std::thread::id here = std::this_thread::get_id();
    std::vector<std::thread::id> slow;
    std::vector<std::thread::id> next;
    REQUIRE(bench.runner->start(1, accept(std::make_unique<SlowerThanItLooks>(slow))));
    REQUIRE(bench.runner->start(2, accept(std::make_unique<BriefJob>(1, 1, next))));
    REQUIRE(bench.run_until_idle());
    REQUIRE(slow.size() == 2);
    CHECK(slow[0] == here);
    CHECK(slow[1] != here);
    REQUIRE(next.size() == 1);
    CHECK(next[0] != here);
    CHECK_FALSE(bench.error().has_value());
    CHECK(bench.metrics.jobs_ended == 2);

    next.clear();
    REQUIRE(bench.runner->start(3, accept(std::make_unique<BriefJob>(1, 1, next))));
    CHECK(next == std::vector<std::thread::id>{here});
}

/// Tasks that a GPU hands back; each then runs on the CPU, where all wait for `release`.
class GivenUpJob final : public Job {
public:
    GivenUpJob(int tasks, FairThreadPool& device, int& handed_out, std::atomic<bool>& release)
        : tasks_(tasks),
          left_(tasks),
          device_(device),
          handed_out_(handed_out),
          release_(release) {}
    std::optional<Task> next() override {
        Task task;
        if (given_up_ > 0) {
            --given_up_;
            ++handed_out_;
            task.run = [this](const Stop&) -> Reply<Frames> {
                while (!release_) std::this_thread::yield();
                --left_;
                return Frames{};
            };
            return task;
        }
        if (tasks_ == 0) return std::nullopt;
        --tasks_;
        task.pool = &device_;
        task.run = [this](const Stop&) -> Reply<Frames> {
            ++given_up_;
            return Frames{};
        };
        return task;
    }
    [[nodiscard]] bool finished() const override { return left_ == 0; }
    Frames farewell() override { return {}; }

private:
    int tasks_;
    std::atomic<int> left_;
    std::atomic<int> given_up_{0};
    FairThreadPool& device_;
    int& handed_out_;  ///< to the CPU
    std::atomic<bool>& release_;
};

TEST_CASE("tasks that a GPU hands back use the whole CPU, and the GPU is free for others") {
    Bench bench;
    FairThreadPool compute(6);
    FairThreadPool device(1);
    const JobContext engine = bench.engine_with(compute);
    const auto runner = std::make_shared<Runner>(engine, bench, "me");
    int handed_out = 0;
    std::atomic<bool> release{false};
    REQUIRE(
        runner->start(1, accept(std::make_unique<GivenUpJob>(20, device, handed_out, release))));
    // One for each thread, one that waits for one and one that waits for its turn.
    const bool all = bench.run_until([&] { return handed_out == 8; });
    std::atomic<bool> on_device{false};
    device.submit("other", Priority::normal, [&] { on_device = true; });
    while (!on_device) std::this_thread::yield();
    release = true;
    CHECK(all);
    REQUIRE(bench.run_until([&] { return runner->size() == 0; }));
    CHECK(handed_out == 20);
}

/// A job of five answers, two of which use up the credit; everything possible has run.
struct Credited {
    static constexpr std::uint64_t bytes = 400 << 10;
    Bench bench;
    FairThreadPool by_hand{0};
    const JobContext engine = bench.engine_with(by_hand);
    const std::shared_ptr<Runner> runner = std::make_shared<Runner>(engine, bench, "me");

    Credited() {
        runner->set_window(Bench::window);
        REQUIRE(runner->start(1, accept(std::make_unique<ScriptedJob>(5, bytes))));
        bench.settle(by_hand);
    }
    ~Credited() { runner->abandon(); }
    std::size_t answers_after(std::uint64_t grant) {
        runner->grant(1, grant);
        bench.settle(by_hand);
        return bench.count(wire::Message::Chunk);
    }
};

TEST_CASE_FIXTURE(Credited, "never more bytes than the client's credit, and every grant is used") {
    // 1 MiB of credit holds two answers of 400 KiB.
    CHECK(bench.count(wire::Message::Chunk) == 2);
    CHECK(runner->waits_for_client());
    CHECK(answers_after(bytes) == 3);
    CHECK(answers_after(bytes) == 4);
    CHECK(runner->size() == 1);
    CHECK(answers_after(bytes) == 5);
    CHECK(runner->size() == 0);
    CHECK_FALSE(bench.error());
}

TEST_CASE_FIXTURE(Credited, "grants never wrap around: two of the largest let the job end") {
    answers_after(std::numeric_limits<std::uint64_t>::max());
    CHECK(answers_after(std::numeric_limits<std::uint64_t>::max()) == 5);
    CHECK(runner->size() == 0);
    CHECK_FALSE(bench.error());
}

TEST_CASE("a full connection parks its jobs until bytes leave") {
    Bench bench;
    bench.waiting = bench.limits.window_bytes;
    REQUIRE(bench.runner->start(1, accept(std::make_unique<ScriptedJob>(3, 1000))));
    CHECK(bench.sent.empty());
    CHECK(bench.runner->waits_for_client());
    bench.waiting = 0;
    bench.runner->pump();
    REQUIRE(bench.run_until_idle());
    CHECK(bench.count(wire::Message::Chunk) == 3);
}

TEST_CASE("any exception of a task fails its job alone") {
    const std::pair<std::function<Reply<void>(const Stop&)>, Code> cases[] = {
        {[](const Stop&) -> Reply<void> { throw std::runtime_error("x"); }, Code::internal},
        {[](const Stop&) -> Reply<void> { throw std::bad_alloc(); }, Code::resource_exhausted},
        {[](const Stop&) -> Reply<void> { throw 7; }, Code::internal},
        {[](const Stop&) -> Reply<void> { return refuse(Code::scene_invalid, "x"); },
         Code::scene_invalid},
    };
    for (const auto& [work, code] : cases) {
        Bench bench;
        REQUIRE(bench.runner->start(1, accept(std::make_unique<ScriptedJob>(3, 10, work))));
        REQUIRE(bench.runner->start(2, accept(std::make_unique<ScriptedJob>(3, 10))));
        REQUIRE(bench.run_until_idle());
        CHECK(bench.error() == code);
        CHECK(bench.count(wire::Message::Error) == 1);
        CHECK(bench.count(wire::Message::Done) == 1);
        CHECK(bench.metrics.jobs_failed == 1);
    }
}

TEST_CASE("a cancelled job keeps its place until its task has stopped") {
    Bench bench;
    std::atomic<bool> running{false};
    std::atomic<bool> may_stop{false};
    const auto work = [&](const Stop& stop) -> Reply<void> {
        running = true;
        while (!stop.requested() || !may_stop) std::this_thread::yield();
        return {};
    };
    REQUIRE(bench.runner->start(1, accept(std::make_unique<ScriptedJob>(1, 10, work))));
    while (!running) std::this_thread::yield();
    bench.runner->cancel(1);
    CHECK(bench.sent.empty());
    CHECK(bench.admission.active() == 1);
    may_stop = true;
    REQUIRE(bench.run_until_idle());
    CHECK(bench.error() == Code::cancelled);
    CHECK(bench.count(wire::Message::Chunk) == 0);
}

TEST_CASE("a job whose task waits for a worker ends without it") {
    Bench bench;
    std::atomic<int> running{0};
    std::atomic<bool> release{false};
    const auto hold = [&](const Stop&) -> Reply<void> {
        ++running;
        while (!release) std::this_thread::yield();
        return {};
    };
    std::atomic<int> ran{0};
    const auto work = [&](const Stop&) -> Reply<void> {
        ++ran;
        return {};
    };
    for (std::uint64_t id : {1U, 2U})
        REQUIRE(bench.runner->start(id, accept(std::make_unique<ScriptedJob>(1, 10, hold))));
    while (running != 2) std::this_thread::yield();
    REQUIRE(bench.runner->start(3, accept(std::make_unique<ScriptedJob>(3, 10, work), 1000)));
    REQUIRE(bench.runner->start(4, accept(std::make_unique<ScriptedJob>(3, 10, work))));
    bench.runner->tick(Clock::now() + seconds(2));
    CHECK(bench.error() == Code::deadline);
    bench.runner->cancel(4);
    CHECK(bench.runner->size() == 2);
    CHECK(bench.admission.active() == 2);
    release = true;
    REQUIRE(bench.run_until_idle());
    CHECK(ran == 0);
    CHECK(bench.count(wire::Message::Chunk) == 2);
}

TEST_CASE("an expired job in the queue is never run") {
    Bench bench;
    std::atomic<int> ran{0};
    bench.waiting = bench.limits.window_bytes;
    const auto work = [&](const Stop&) -> Reply<void> {
        ++ran;
        return {};
    };
    REQUIRE(bench.runner->start(1, accept(std::make_unique<ScriptedJob>(3, 10, work), 1000)));
    bench.runner->tick(Clock::now() + seconds(2));
    CHECK(bench.error() == Code::deadline);
    CHECK(bench.runner->size() == 0);
    bench.waiting = 0;
    bench.runner->pump();
    CHECK(ran == 0);
}

TEST_CASE("a job waits for its client as long as it takes, and reports to one that reads") {
    Bench bench;
    class Waiting final : public Job {
        std::optional<Task> next() override { return std::nullopt; }
        [[nodiscard]] bool finished() const override { return false; }
        [[nodiscard]] bool needs_input() const override { return true; }
        [[nodiscard]] std::optional<Progress> progress() const override { return Progress{}; }
        Frames farewell() override { return {}; }
    };
    REQUIRE(bench.runner->start(1, accept(std::make_unique<Waiting>())));
    const Clock::time_point begin = Clock::now();
    bench.runner->tick(begin + std::chrono::hours(1));
    CHECK(bench.count(wire::Message::Progress) == 1);
    bench.waiting = 1;
    bench.runner->tick(begin + std::chrono::hours(2));
    CHECK(bench.count(wire::Message::Progress) == 1);
    CHECK(bench.runner->size() == 1);
    CHECK(bench.runner->waits_for_client());
    CHECK_FALSE(bench.error());
    bench.runner->cancel(1);
}

/// A connection that has paused since the clock's start.
class Pausing final : public Peer {
public:
    Pausing(JobContext& engine, Runner& runner) : engine_(engine), runner_(runner) {
        engine_.peers.join(*this);
    }
    ~Pausing() { engine_.peers.leave(*this); }
    [[nodiscard]] const std::string& principal() const override { return principal_; }
    [[nodiscard]] std::uint64_t holds(Resource resource) const override {
        return resource == Resource::memory ? runner_.held_bytes() : runner_.size();
    }
    [[nodiscard]] std::optional<Clock::time_point> paused_since() const override {
        return runner_.waits_for_client() ? std::optional(Clock::time_point()) : std::nullopt;
    }
    void give_way(const protocol::Error& /*why*/) override {
        engine_.peers.leave(*this);
        runner_.abandon();
    }

private:
    JobContext& engine_;
    Runner& runner_;
    const std::string principal_ = "other";
};

TEST_CASE("a full daemon takes the places and the memory of jobs that wait for their client") {
    Bench bench;
    const auto other = std::make_shared<Runner>(bench.engine, bench, "other");
    Pausing pausing(bench.engine, *other);
    JobSubmission large = accept(std::make_unique<ScriptedJob>(1, 10));
    large.answer_bytes = bench.limits.window_bytes;
    REQUIRE(other->start(1, std::move(large)));  // its client grants no credit
    // Its share is all places but one, which a third has.
    for (std::uint64_t id = 2; id < bench.limits.total_jobs_max; ++id)
        REQUIRE(other->start(id, accept(std::make_unique<ScriptedJob>(1, 10))));
    const auto third = std::make_shared<Runner>(bench.engine, bench, "third");
    REQUIRE(third->start(1, accept(std::make_unique<ScriptedJob>(1, 10))));
    CHECK(other->held_bytes() == bench.limits.window_bytes);
    auto rest = bench.budget.reserve(bench.budget.limit() - bench.budget.used());
    JobSubmission newcomer = accept(std::make_unique<ScriptedJob>(1, 10));
    newcomer.answer_bytes = bench.limits.window_bytes / 2;
    REQUIRE(bench.runner->start(1, std::move(newcomer)));
    CHECK(bench.metrics.gave_way_jobs == 1);
    CHECK(other->size() == 0);
    CHECK(other->held_bytes() == 0);
    third->abandon();
    REQUIRE(bench.run_until_idle());
    CHECK(bench.count(wire::Message::Done) == 1);
}

TEST_CASE("a full daemon answers BUSY with a retry time") {
    Bench bench;
    bench.waiting = bench.limits.window_bytes;
    for (std::uint64_t id = 1; id <= 3; ++id)
        REQUIRE(bench.runner->start(id, accept(std::make_unique<ScriptedJob>(1, 10))));
    const auto other = std::make_shared<Runner>(bench.engine, bench, "other");
    other->set_window(Bench::window);
    REQUIRE(other->start(1, accept(std::make_unique<ScriptedJob>(1, 10))));
    const auto busy = other->start(2, accept(std::make_unique<ScriptedJob>(1, 10)));
    REQUIRE_FALSE(busy);
    CHECK(busy.error().code == Code::busy);
    CHECK(busy.error().retry_after_ms > 0);
    other->abandon();
}

TEST_CASE("an abandoned runner is silent, and its jobs still end") {
    Bench bench;
    std::atomic<bool> running{false};
    const auto work = [&](const Stop& stop) -> Reply<void> {
        running = true;
        while (!stop.requested()) std::this_thread::yield();
        return {};
    };
    REQUIRE(bench.runner->start(1, accept(std::make_unique<ScriptedJob>(9, 10, work))));
    while (!running) std::this_thread::yield();
    bench.runner->abandon();
    REQUIRE(bench.run_until_idle());
    CHECK(bench.sent.empty());
    CHECK(bench.metrics.jobs_started == bench.metrics.jobs_ended);
}

/// Accepts all input and never ends.
class Sponge final : public Job {
    std::optional<Task> next() override { return std::nullopt; }
    [[nodiscard]] bool finished() const override { return false; }
    Frames farewell() override { return {}; }
    Reply<std::uint64_t> feed(protocol::Frame frame) override { return frame.header.bulk_bytes; }
};

TEST_CASE("memory for a client's input is reserved before it sends, and returns with the job") {
    Bench bench;
    const auto sponge = [](std::uint64_t bytes) {
        JobSubmission accepted = accept(std::make_unique<Sponge>());
        accepted.input_bytes = bytes;
        return accepted;
    };
    REQUIRE(bench.runner->start(1, sponge(1000)));
    CHECK(bench.budget.used() == 1000);
    // The reservation never exceeds the credit, whatever a request announces.
    REQUIRE(bench.runner->start(2, sponge(1ULL << 40)));
    CHECK(bench.budget.used() == 1000 + bench.limits.window_bytes);
    auto rest = bench.budget.reserve(bench.budget.limit() - bench.budget.used() - (4 << 20));
    const std::uint64_t most = bench.budget.room("me", Use::passing);
    const auto refused = bench.runner->start(3, sponge(most + 1));
    REQUIRE_FALSE(refused);
    CHECK(refused.error().code == Code::resource_exhausted);
    CHECK(bench.admission.active() == 2);
    REQUIRE(bench.runner->start(3, sponge(most)));
    for (std::uint64_t id = 1; id <= 3; ++id) bench.runner->cancel(id);
    *rest = {};
    CHECK(bench.budget.used() == 0);
}

TEST_CASE("only a job that waits for data gets memory for it") {
    Bench bench;
    CHECK_FALSE(bench.runner->admit(1, 0));
    REQUIRE(bench.runner->start(1, accept(std::make_unique<Sponge>())));
    CHECK(bench.runner->admit(1, bench.limits.window_bytes));
    CHECK_FALSE(bench.runner->admit(1, bench.limits.window_bytes + 1));
    // A bulk part that was skipped for lack of credit stays beyond the credit.
    protocol::Frame passed = chunk_of(1000);
    passed.bulk = {};
    bench.runner->feed(std::move(passed));
    CHECK(bench.error() == Code::limit_exceeded);
    CHECK_FALSE(bench.runner->admit(1, 0));
}

TEST_CASE("input beyond the credit ends the job, input within it is granted again") {
    Bench bench;
    REQUIRE(bench.runner->start(1, accept(std::make_unique<Sponge>())));
    const std::uint64_t quarter = bench.limits.window_bytes / 4;
    for (int i = 0; i < 12; ++i) bench.runner->feed(chunk_of(quarter));
    CHECK(bench.count(wire::Message::Credit) == 12);
    CHECK_FALSE(bench.error());
    bench.runner->feed(chunk_of(bench.limits.window_bytes + 64));
    CHECK(bench.error() == Code::limit_exceeded);
}

}  // namespace
}  // namespace raynest::server
