// Tests detached jobs with scripted ones: which results are kept, for how long, at whose cost.
#include "server/scheduling/detached.h"

#include "tests/unit/server/bench.h"

#include <doctest/doctest.h>

#include <atomic>
#include <chrono>
#include <new>
#include <thread>

namespace raynest::server {
namespace {

using std::chrono::milliseconds;

constexpr std::uint64_t room = 64 << 10;  ///< most bytes of a scripted job's answer

struct Store {
    Store() { bench.limits.principal_result_bytes_max = 3 * (room + (16 << 10)); }

    Reply<DetachedJobs::Pointer> start(const std::string& principal, std::size_t tasks,
                                       std::uint64_t bytes,
                                       std::function<Reply<void>(const Stop&)> work = {}) {
        JobSubmission accepted =
            accept(std::make_unique<ScriptedJob>(tasks, bytes, std::move(work)));
        accepted.detach = true;
        accepted.result_bytes = room;
        return jobs.start({principal, {}, Role::user}, 1, std::move(accepted));
    }
    /// Runs a job to its end, fetched or not; returns its number.
    std::uint64_t keep(const std::string& principal, std::uint64_t bytes, bool fetched) {
        auto job = start(principal, 1, bytes).value();
        REQUIRE(bench.run_until([&] { return job->ended(); }));
        if (fetched) job->set_fetched();
        return job->record().number;
    }
    [[nodiscard]] bool has(std::uint64_t number) const { return jobs.all().contains(number); }

    Bench bench;
    int changes = 0;
    DetachedJobs jobs{bench.engine, [this] { ++changes; }};
};

/// The sink of the connection that sends a job's data.
class Feeder final : public Sink {
public:
    void send(protocol::Frame frame) override { types.push_back(frame.header.type); }
    [[nodiscard]] std::uint64_t backlog() const override { return 0; }
    std::vector<std::uint16_t> types;
};

TEST_CASE("an answer is kept whole, and the room it did not need goes back") {
    Store store;
    const auto job = store.start("me", 5, 1000).value();
    CHECK(store.changes == 1);
    CHECK(store.bench.budget.used() >= room);
    CHECK_FALSE(job->ended());
    REQUIRE(store.bench.run_until([&] { return job->ended(); }));
    CHECK_FALSE(job->error());
    REQUIRE(job->answer().frames.size() == 6);
    CHECK(job->answer().frames.back().header.type ==
          static_cast<std::uint16_t>(wire::Message::Done));
    CHECK(store.bench.budget.used() < room);
    CHECK(store.bench.budget.used() > 5 * 1000);
    CHECK(store.bench.admission.active() == 0);
}

TEST_CASE("a picture so far takes the place of the one before") {
    constexpr std::uint64_t bytes = 10'000;
    /// Sends the same picture again and again.
    class Painter final : public Job {
    public:
        std::optional<Task> next() override {
            if (left_ == 0) return std::nullopt;
            --left_;
            Task task;
            task.reply_bytes_max = protocol::padded(bytes);
            task.run = [](const Stop&) -> Reply<Frames> {
                protocol::Bulk bulk;
                bulk.add("data", wire::Dtype::u8, 1, bytes);
                bulk.allocate();
                wire::PayloadT picture;
                picture.width = 100;
                picture.height = 25;
                picture.encode = "raw";
                picture.total = bytes;
                picture.last = false;
                Frames frames;
                frames.push_back(protocol::encode(1, std::move(picture), std::move(bulk)).value());
                return frames;
            };
            return task;
        }
        [[nodiscard]] bool finished() const override { return left_ == 0; }
        Frames farewell() override {
            Frames frames;
            frames.push_back(protocol::encode(1, wire::DoneT{}).value());
            return frames;
        }

    private:
        std::size_t left_ = 40;
    };
    Store store;
    JobSubmission accepted = accept(std::make_unique<Painter>());
    accepted.detach = true;
    accepted.result_bytes = room;
    const auto job = store.jobs.start({"me", {}, Role::user}, 1, std::move(accepted)).value();
    REQUIRE(store.bench.run_until([&] { return job->ended(); }));
    CHECK_MESSAGE(!job->error(), (job->error() ? job->error()->message : ""));
    CHECK(job->answer().frames.size() == 1);
    CHECK(store.bench.budget.used() < room);
}

TEST_CASE("running jobs of owners who are admitted no more end, and their answers stay") {
    Store store;
    const std::uint64_t kept = store.keep("mallory", 1000, false);
    const auto endless = [](const Stop& stop) -> Reply<void> {
        while (!stop.requested()) std::this_thread::yield();
        return {};
    };
    const auto ends = store.start("mallory", 1, 1000, endless).value();
    const auto goes_on = store.start("me", 1, 1000, endless).value();
    store.jobs.end_unless([](const Principal& owner) { return owner.id == "me"; },
                          {Code::not_allowed, "revoked", 0});
    REQUIRE(store.bench.run_until([&] { return ends->ended(); }));
    CHECK(ends->error()->code == Code::not_allowed);
    CHECK_FALSE(goes_on->ended());
    CHECK(store.has(kept));
    store.jobs.cancel(goes_on->record().number);
    REQUIRE(store.bench.run_until_idle());
}

TEST_CASE("an answer goes away when its time is over, and not before") {
    Store store;
    const std::uint64_t number = store.keep("me", 1000, false);
    const Clock::time_point end = store.jobs.all().at(number)->expiry();
    const milliseconds kept(store.bench.limits.result_ms_max);
    CHECK(end > Clock::now() + kept / 2);
    CHECK(end <= Clock::now() + kept);
    CHECK(store.jobs.next_tick() == end);
    store.jobs.tick(end - milliseconds(1));
    CHECK(store.has(number));
    store.jobs.tick(end);
    CHECK_FALSE(store.has(number));
    CHECK(store.bench.budget.used() == 0);
}

TEST_CASE("fetched results make room, the oldest first, and others are never dropped") {
    Store store;
    const std::uint64_t dear = store.keep("me", 60'000, false);
    const std::uint64_t old = store.keep("me", 60'000, true);
    const std::uint64_t young = store.keep("me", 60'000, true);
    const std::uint64_t foreign = store.keep("you", 60'000, true);
    const std::uint64_t next = store.keep("me", 60'000, false);
    CHECK(store.has(dear));
    CHECK_FALSE(store.has(old));
    CHECK(store.has(young));
    const std::uint64_t last = store.keep("me", 60'000, false);
    CHECK_FALSE(store.has(young));
    // The store is full of unfetched results: the next job is refused before it runs.
    const auto refused = store.start("me", 1, 1000);
    REQUIRE_FALSE(refused);
    CHECK(refused.error().code == Code::quota);
    CHECK(refused.error().message.find("--principal-result-bytes-max") != std::string::npos);
    CHECK(store.has(dear));
    CHECK(store.has(next));
    CHECK(store.has(last));
    CHECK(store.has(foreign));
    CHECK(store.bench.admission.active() == 0);
}

TEST_CASE(
    "when --memory is short, the principal's own fetched answers go, then its job is refused") {
    Store store;
    const std::uint64_t dear = store.keep("me", 60'000, false);
    const std::uint64_t fetched = store.keep("me", 60'000, true);
    const std::uint64_t foreign = store.keep("you", 60'000, true);
    Budget& budget = store.bench.budget;
    auto rest = budget.reserve(budget.limit() - budget.used() - 50'000);
    REQUIRE(rest);
    const auto started = store.start("me", 1, 1000);
    CHECK(started);
    CHECK_FALSE(store.has(fetched));
    const auto refused = store.start("me", 1, 1000);
    REQUIRE_FALSE(refused);
    CHECK(refused.error().code == Code::resource_exhausted);
    CHECK(store.has(dear));
    CHECK(store.has(foreign));
    REQUIRE(store.bench.run_until_idle());
}

TEST_CASE("a job is found by its number") {
    Store store;
    const std::uint64_t number = store.keep("me", 10, false);
    CHECK(store.jobs.find(number));
    CHECK(store.jobs.find(number + 1).error().code == Code::job_unknown);
}

TEST_CASE("a failed job keeps its error and no bytes") {
    Store store;
    const auto job = store.start("me", 9, 1000, [](const Stop&) -> Reply<void> {
        return refuse(Code::scene_invalid, "no");
    });
    REQUIRE(store.bench.run_until([&] { return (*job)->ended(); }));
    REQUIRE((*job)->error());
    CHECK((*job)->error()->code == Code::scene_invalid);
    CHECK((*job)->answer().frames.empty());
    CHECK(store.bench.budget.used() < room);
    REQUIRE(store.bench.run_until_idle());
}

TEST_CASE("an answer that outgrows its room takes more, from fetched results if necessary") {
    Store store;
    const std::uint64_t dear = store.keep("me", 60'000, false);
    const std::uint64_t fetched = store.keep("me", 60'000, true);
    auto job = store.start("me", 12, 10'000).value();
    REQUIRE(store.bench.run_until([&] { return job->ended(); }));
    CHECK_FALSE(job->error());
    CHECK(job->answer().frames.size() == 13);
    CHECK(job->bytes() >= 120'000);
    CHECK(store.has(dear));
    CHECK_FALSE(store.has(fetched));
    store.jobs.cancel(job->record().number);
    store.jobs.cancel(dear);
    job.reset();
    CHECK(store.bench.budget.used() == 0);
}

TEST_CASE("an answer beyond its owner's quota ends the job, and its sender is told") {
    Store store;
    Feeder feeder;
    const auto job = store.start("me", 100, 10'000);
    (*job)->set_feeder(&feeder);
    REQUIRE(store.bench.run_until_idle());
    CHECK(feeder.types ==
          std::vector<std::uint16_t>{static_cast<std::uint16_t>(wire::Message::Error)});
    REQUIRE((*job)->error());
    CHECK((*job)->error()->code == Code::quota);
    CHECK(store.bench.budget.used() < room);
}

TEST_CASE("cancelling stops running jobs, drops results, and frees all memory") {
    Store store;
    std::atomic<bool> running{false};
    const auto work = [&](const Stop& stop) -> Reply<void> {
        running = true;
        while (!stop.requested()) std::this_thread::yield();
        return {};
    };
    const std::uint64_t kept = store.keep("me", 1000, false);
    const std::uint64_t runs = store.start("me", 1, 10, work).value()->record().number;
    while (!running) std::this_thread::yield();
    store.jobs.cancel(runs);
    store.jobs.cancel(kept);
    CHECK(store.jobs.all().empty());
    REQUIRE(store.bench.run_until([&] { return store.bench.admission.active() == 0; }));
    CHECK(store.bench.budget.used() == 0);
}

TEST_CASE("a daemon that ends stops running jobs with DRAINING, and keeps ended ones") {
    Store store;
    const auto endless = [](const Stop& stop) -> Reply<void> {
        while (!stop.requested()) std::this_thread::yield();
        return refuse(Code::cancelled, "");
    };
    const std::uint64_t kept = store.keep("me", 1000, false);
    const auto runs = store.start("me", 1, 10, endless).value();
    store.jobs.stop_running();
    REQUIRE(store.bench.run_until_idle());
    REQUIRE(runs->error());
    CHECK(runs->error()->code == Code::draining);
    CHECK_FALSE(store.jobs.all().at(kept)->error());
}

TEST_CASE("the sender of a job's data gets its credit and its failure") {
    class Sponge final : public Job {
        std::optional<Task> next() override { return std::nullopt; }
        [[nodiscard]] bool finished() const override { return false; }
        [[nodiscard]] bool needs_input() const override { return true; }
        Frames farewell() override { return {}; }
        Reply<std::uint64_t> feed(protocol::Frame frame) override {
            return frame.header.bulk_bytes;
        }
    };
    Store store;
    Feeder feeder;
    JobSubmission accepted = accept(std::make_unique<Sponge>());
    accepted.detach = true;
    const auto job = store.jobs.start({"me", {}, Role::user}, 1, std::move(accepted)).value();
    job->set_feeder(&feeder);
    CHECK(job->runner().needs_client(1));
    job->runner().feed(chunk_of(store.bench.limits.window_bytes / 4));
    job->runner().fail(1, {Code::deadline, "", 0});
    CHECK(job->ended());
    CHECK_FALSE(job->runner().needs_client(1));
    CHECK(feeder.types ==
          std::vector<std::uint16_t>{static_cast<std::uint16_t>(wire::Message::Credit),
                                     static_cast<std::uint16_t>(wire::Message::Error)});
}

TEST_CASE("the sender of a job's data gets a failure at its very start") {
    class Failing final : public Job {
        std::optional<Task> next() override { throw std::bad_alloc(); }
        [[nodiscard]] bool finished() const override { return false; }
        Frames farewell() override { return {}; }
    };
    Store store;
    Feeder feeder;
    JobSubmission accepted = accept(std::make_unique<Failing>());
    accepted.detach = true;
    const auto job =
        store.jobs.start({"me", {}, Role::user}, 1, std::move(accepted), &feeder).value();
    REQUIRE(job->error());
    CHECK(job->error()->code == Code::resource_exhausted);
    CHECK(feeder.types ==
          std::vector<std::uint16_t>{static_cast<std::uint16_t>(wire::Message::Error)});
}

}  // namespace
}  // namespace raynest::server
