// The memory of the frame on its way: of its job, and of its connection when the job has ended.
#include "server/sessions/arriving_frame.h"

#include "tests/unit/server/bench.h"
#include "tests/unit/server/memory_transport.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <chrono>
#include <memory>
#include <optional>
#include <span>
#include <utility>
#include <vector>

namespace raynest::server {
namespace {

/// Accepts all input and never ends; reads it at once, or never.
class Sponge final : public Job {
public:
    explicit Sponge(bool reads) : reads_(reads) {}

private:
    std::optional<Task> next() override { return std::nullopt; }
    [[nodiscard]] bool finished() const override { return false; }
    Frames farewell() override { return {}; }
    Reply<std::uint64_t> feed(protocol::Frame frame) override {
        return reads_ ? frame.header.bulk_bytes : 0;
    }
    const bool reads_;
};

JobSubmission sponge(std::uint64_t announced, bool reads = true) {
    JobSubmission accepted = accept(std::make_unique<Sponge>(reads));
    accepted.input_bytes = announced;
    return accepted;
}

TEST_CASE("a frame beyond what its request announced is reserved, or ends the request") {
    Bench bench;
    REQUIRE(bench.runner->start(1, sponge(100)));
    auto frame = bench.runner->admit(1, 64);
    REQUIRE(frame);
    CHECK(bench.budget.used() == 100);
    frame = bench.runner->admit(1, 128);
    REQUIRE(frame);
    CHECK(bench.budget.used() == 128);
    CHECK(bench.runner->held_bytes() == 128);
    // Its memory stays with the frame when the job ends first.
    bench.runner->cancel(1);
    CHECK(bench.runner->held_bytes() == 0);
    CHECK(bench.budget.used() == 128);
    frame.reset();
    CHECK(bench.budget.used() == 0);

    REQUIRE(bench.runner->start(2, sponge(0)));
    const auto rest = bench.budget.reserve(bench.budget.limit());
    bench.sent.clear();
    CHECK_FALSE(bench.runner->admit(2, 64));
    CHECK(bench.error() == Code::resource_exhausted);
    CHECK(bench.runner->size() == 0);
}

TEST_CASE("a frame on its way is covered besides the data that its job has not read") {
    Bench bench;
    REQUIRE(bench.runner->start(1, sponge(1024, false)));
    REQUIRE(bench.runner->admit(1, 1024));
    bench.runner->feed(chunk_of(1024));
    CHECK(bench.budget.used() == 1024);
    REQUIRE(bench.runner->admit(1, 512));
    CHECK(bench.budget.used() == 1024 + 512);
    bench.runner->cancel(1);
    CHECK(bench.budget.used() == 0);
}

/// A peer that has sent the first half of a frame for a request, which has ended since.
struct HalfSent {
    explicit HalfSent(bool detach) {
        peer->say(0, wire::HelloT{});
        house.settle();
        wire::QueryT query;
        query.job = std::make_unique<wire::JobT>();
        query.job->scene = "forest";
        query.job->detach = detach;
        query.job->deadline_ms = 30;
        query.ray_count = 2 * rays;
        peer->say(5, query);
        protocol::Bulk bulk;
        bulk.add("rays", wire::Dtype::f32, 8, rays);
        bulk.allocate();
        std::fill_n(bulk.block(0).data(), bulk.block(0).size(), std::byte{0});
        bytes =
            golden::wire_bytes(protocol::encode(5, wire::QueryRaysT{}, std::move(bulk)).value());
        peer->send(std::span(bytes).first(bytes.size() / 2));
        house.settle();
        CHECK(held() >= rays * sizeof(Ray));
        REQUIRE(test::eventually([&] {
            house.settle_for(std::chrono::milliseconds(10));
            house.daemon.detached.tick(Clock::now());
            house.settle();
            return house.daemon.metrics.deadlines_passed == 1;
        }));
    }
    [[nodiscard]] std::uint64_t held() const {
        return house.daemon.peers.held_by("memory", Resource::memory);
    }

    static constexpr std::uint64_t rays = 10000;
    static protocol::Limits hasty() {
        protocol::Limits limits;
        limits.give_way_ms = 0;
        return limits;
    }
    test::MemoryDaemon house{hasty()};
    const std::unique_ptr<test::MemoryPeer> peer = house.connect();
    std::vector<std::byte> bytes;
};

TEST_CASE("a frame whose request has ended is counted until it is here") {
    for (const bool detach : {false, true}) {
        CAPTURE(detach);
        HalfSent half(detach);
        CHECK(half.held() == HalfSent::rays * sizeof(Ray));
        half.house.daemon.detached.clear();  // what is kept of the job
        CHECK(half.house.daemon.budget.held_by("memory") == half.held());
        half.peer->send(std::span(half.bytes).subspan(half.bytes.size() / 2));
        half.peer->say(6, wire::PingT{});
        half.peer->take_frames();
        half.house.settle();
        CHECK(half.peer->take_frames().size() == 1);
        CHECK(half.held() == 0);
        CHECK(half.house.daemon.budget.held_by("memory") == 0);
    }
}

TEST_CASE("who stops in the middle of a frame whose request has ended gives way") {
    HalfSent half(false);
    Budget& budget = half.house.daemon.budget;
    const auto lease = half.house.daemon.peers.reserve(
        budget.room("newcomer", Use::passing, {.requests = half.held()}), "newcomer");
    CHECK(lease);
    CHECK(half.house.daemon.metrics.gave_way_memory == 1);
    half.house.settle();
    CHECK(half.peer->wire->closed);
    CHECK(budget.held_by("memory") == 0);
}

}  // namespace
}  // namespace raynest::server
