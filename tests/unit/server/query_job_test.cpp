// The chunks of a query: what a backend gives up is traced again, all of it, and the frames that
// the client sent stay until then.
#include "server/jobs/query_job.h"

#include "server/execution/choose_backends.h"
#include "server/requests/words/generator.h"
#include "server/requests/words/make_plan.h"
#include "tests/unit/server/scripted_backend.h"
#include "tests/unit/server/small_daemon.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cstdint>
#include <numeric>
#include <optional>
#include <utility>
#include <vector>

namespace raynest::server {
namespace {

constexpr std::uint64_t frame_rays = 1000;

/// Notes the chunks that it is asked to answer, as {first, count}.
class NotedQuery final : public QueryJob {
public:
    NotedQuery(const Services& services, const Caller& caller, Plan plan, RaySource source)
        : QueryJob(services, caller, std::move(plan), std::move(source)) {}
    [[nodiscard]] std::uint64_t result_bytes() const override { return 0; }

    std::vector<std::pair<std::uint64_t, std::uint64_t>> given_up, traced;

protected:
    Traced<Frames> trace(const Chunk& chunk, const Stop& stop, TraceBuffers& buffers) override {
        const auto rays = source_.trace(plan_, chunk, input_, stop, buffers, false);
        (rays ? traced : given_up).emplace_back(chunk.first, chunk.count);
        if (!rays) return tl::unexpected(rays.error());
        answered(chunk, chunk.count);
        return Frames{};
    }
    [[nodiscard]] std::uint64_t chunk_size(const Backend& backend,
                                           const Chunk& /*rest*/) const override {
        return std::min<std::uint64_t>(backend.call_rays_max(plan_), 1 << 20);
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

/// The code that refuses two rays with this block beside them, which comes `first` or second.
std::optional<Code> refusal_of(const char* name, wire::Dtype dtype, std::uint64_t count,
                               bool first = false) {
    protocol::Bulk bulk;
    if (first) bulk.add(name, dtype, 1, count);
    bulk.add("rays", wire::Dtype::f32, 8, 2);
    if (!first) bulk.add(name, dtype, 1, count);
    bulk.allocate();
    const auto frame = protocol::encode(1, wire::QueryRaysT{}, std::move(bulk)).value();
    const auto message = protocol::open<wire::QueryRays>(frame);
    REQUIRE(message);
    const auto sent = SentRays::of(*message);
    if (!sent) return sent.error().code;
    CHECK(sent->masks().size() == count);
    return std::nullopt;
}

TEST_CASE("the rays of a frame have one mask each, or none") {
    CHECK_FALSE(refusal_of("masks", wire::Dtype::u32, 2));
    CHECK(refusal_of("masks", wire::Dtype::u32, 2, true) == Code::invalid_field);
    CHECK(refusal_of("masks", wire::Dtype::u32, 1) == Code::invalid_field);
    CHECK(refusal_of("masks", wire::Dtype::u32, 3) == Code::invalid_field);
    CHECK(refusal_of("masks", wire::Dtype::u8, 2) == Code::invalid_field);
    CHECK(refusal_of("mask", wire::Dtype::u32, 2) == Code::invalid_field);
}

/// A frame of rays with these masks, or with none.
protocol::Frame frame_of_masks(std::uint64_t first, std::uint64_t count,
                               const std::vector<std::uint32_t>& masks) {
    protocol::Bulk bulk;
    bulk.add("rays", wire::Dtype::f32, 8, count);
    if (!masks.empty()) bulk.add("masks", wire::Dtype::u32, 1, masks.size());
    bulk.allocate();
    std::ranges::fill(bulk.block_as<float>(0), 1.0F);
    if (!masks.empty()) std::ranges::copy(masks, bulk.block_as<std::uint32_t>(1).begin());
    wire::QueryRaysT rays;
    rays.first_ray = first;
    return protocol::encode(1, std::move(rays), std::move(bulk)).value();
}

TEST_CASE("rays of a frame without masks meet everything, and masks count over all frames") {
    constexpr std::uint64_t each = 40;
    const protocol::Limits limits;
    REQUIRE(each < limits.ray_masks_max);
    REQUIRE(2 * each > limits.ray_masks_max);
    Budget budget(1 << 20);
    RayInput input(3 * each, 1, limits, budget, "me");
    std::vector<std::uint32_t> masks(each);
    std::iota(masks.begin(), masks.end(), 100U);
    REQUIRE(input.feed(frame_of_masks(0, each, masks)));
    REQUIRE(input.feed(frame_of_masks(each, each, {})));
    std::ranges::transform(masks, masks.begin(), [](std::uint32_t mask) { return mask + 1000; });
    REQUIRE(input.feed(frame_of_masks(2 * each, each, masks)));
    TraceBuffers buffers(budget);
    const auto found = input.masks(each - 1, 3, buffers);
    REQUIRE(found);
    CHECK(std::vector(found->begin(), found->end()) ==
          std::vector<std::uint32_t>{100 + each - 1, ~0U, ~0U});
    CHECK(input.masks(0, each, buffers));
    // Each of them alone has few.
    CHECK(input.masks(2 * each, each, buffers).error().code == Code::limit_exceeded);
}

TEST_CASE("a failed GPU call of several frames is traced again in full") {
    protocol::Limits limits;
    limits.chunk_rays_max = frame_rays;
    test::SmallDaemon daemon(limits);
    put_first(daemon.backends, std::make_unique<ScriptedBackend>(1 << 20, 1, [](std::uint64_t) {
                  return ScriptedBackend::Does::refuses;
              }));
    wire::QueryT query;
    query.job = std::make_unique<wire::JobT>();
    query.job->scene = "forest";
    query.ray_count = 3 * frame_rays;
    const auto frame = protocol::encode(1, query, daemon.limits).value();
    const auto message = protocol::open<wire::Query>(frame, daemon.limits);
    REQUIRE(message);
    const Caller caller{{"me", 1}, 1, 1 << 20};
    auto plan = make_plan(daemon.services, caller, job_words(*(*message)->job()), query_closest);
    REQUIRE(plan);
    REQUIRE(choose_backends(daemon.backends, query.ray_count, *plan));
    auto source = read_rays(*message->table, plan->scene.snapshot());
    REQUIRE(source);
    NotedQuery job(daemon.services, caller, std::move(*plan), std::move(*source));

    for (std::uint64_t i = 0; i < 3; ++i) REQUIRE(job.feed(frame_of_rays(i * frame_rays)));
    CHECK_FALSE(job.needs_input());
    const StopFlag stop(Clock::time_point::max());
    int tasks = 0;
    std::uint64_t freed = 0;
    while (std::optional<Task> task = job.next()) {
        ++tasks;
        CHECK((task->pool != nullptr) == (tasks == 1));
        REQUIRE(task->run(stop));
        if (tasks == 1) CHECK(job.take_freed_input() == 0);
        freed += job.take_freed_input();
    }
    using Chunks = std::vector<std::pair<std::uint64_t, std::uint64_t>>;
    CHECK(job.given_up == Chunks{{0, 3 * frame_rays}});
    CHECK(job.traced ==
          Chunks{{0, frame_rays}, {frame_rays, frame_rays}, {2 * frame_rays, frame_rays}});
    CHECK(freed == 3 * frame_rays * sizeof(Ray));
    CHECK(job.finished());
}

}  // namespace
}  // namespace raynest::server
