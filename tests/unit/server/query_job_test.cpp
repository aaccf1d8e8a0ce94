// The pieces of a query: what a GPU gives up is traced again, all of it.
#include "server/handlers/query_job.h"

#include "tests/unit/server/small_daemon.h"

#include <doctest/doctest.h>

#include <array>
#include <cstddef>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace raynest::server {
namespace {

constexpr std::uint64_t frame_rays = 1000;

/// Every call of the GPU fails; what comes back is answered, and noted as {first, count}.
class GivenUpQuery final : public QueryJob {
public:
    GivenUpQuery(const Services& services, const Caller& caller, Plan plan, RaySource source)
        : QueryJob(services, caller, std::move(plan), std::move(source)) {}
    [[nodiscard]] std::uint64_t result_bytes() const override { return 0; }

    std::vector<std::pair<std::uint64_t, std::uint64_t>> given_up, answered;

protected:
    Reply<Frames> answer(const Piece& piece, const Stop& /*stop*/) override {
        TraceBuffers& buffers = TraceBuffers::of_this_thread();
        if (on_cuda(piece)) {
            given_up.emplace_back(piece.first, piece.count);
            buffers.fallback = "lost";
            return refuse(Code::internal, "lost");
        }
        answered.emplace_back(piece.first, piece.count);
        tally_.add(buffers, {piece.count, 0, piece.count, 0});
        return Frames{};
    }
    [[nodiscard]] std::uint64_t piece_rays(const Piece& rest) const override {
        return on_cuda(rest) ? 1 << 20 : frame_rays;
    }
    [[nodiscard]] std::uint64_t reply_bytes(std::uint64_t /*rays*/) const override { return 0; }
    [[nodiscard]] std::uint64_t rows() const override { return 0; }
};

protocol::Frame frame_of_rays(std::uint64_t first) {
    protocol::Bulk bulk;
    bulk.add("rays", wire::Dtype::f32, 8, frame_rays);
    bulk.allocate();
    for (float& value : bulk.block_as<float>(0)) value = 1;
    wire::QueryRaysT rays;
    rays.first_ray = first;
    return protocol::encode(1, std::move(rays), std::move(bulk)).value();
}

TEST_CASE("of a GPU's call of several frames all are traced again when it is given up") {
    test::SmallDaemon daemon;
    wire::QueryT query;
    query.job = std::make_unique<wire::JobT>();
    query.job->scene = "forest";
    query.ray_count = 3 * frame_rays;
    const auto frame = protocol::encode(1, query, daemon.limits).value();
    const auto message = protocol::open<wire::Query>(frame, daemon.limits);
    REQUIRE(message);
    const Caller caller{{"me", 1}, 1, 1 << 20};
    auto plan = make_plan(daemon.services, caller, *(*message)->job(), query_closest, false);
    REQUIRE(plan);
    // Nobody looks behind the pointer: that there is one says whose the rays are.
    alignas(device::Worker) std::array<std::byte, sizeof(device::Worker)> somewhere{};
    plan->worker.cuda = reinterpret_cast<device::Worker*>(somewhere.data());
    auto source = RaySource::make(*message->table, plan->scene.snapshot());
    REQUIRE(source);
    GivenUpQuery job(daemon.services, caller, std::move(*plan), std::move(*source));

    for (std::uint64_t i = 0; i < 3; ++i) REQUIRE(job.feed(frame_of_rays(i * frame_rays)));
    const StopFlag stop(Clock::time_point::max());
    int tasks = 0;
    while (std::optional<Task> task = job.next()) {
        ++tasks;
        REQUIRE(task->lane == (tasks == 1 ? Lane::device : Lane::compute));
        REQUIRE(task->run(stop));
    }
    using Runs = std::vector<std::pair<std::uint64_t, std::uint64_t>>;
    CHECK(job.given_up == Runs{{0, 3 * frame_rays}});
    CHECK(job.answered ==
          Runs{{0, frame_rays}, {frame_rays, frame_rays}, {2 * frame_rays, frame_rays}});
    CHECK(job.finished());
    CHECK_FALSE(job.needs_input());
}

}  // namespace
}  // namespace raynest::server
