// Plans: which requests a common call may answer.
#include "server/execution/plan.h"

#include "server/requests/words/make_plan.h"
#include "tests/unit/server/small_daemon.h"

#include <doctest/doctest.h>

#include <functional>
#include <memory>

namespace raynest::server {
namespace {

TEST_CASE("a common call answers requests that differ in nothing that decides hits") {
    test::SmallDaemon daemon;
    const auto plan = [&](const std::function<void(wire::JobT&)>& change,
                          Query query = query_closest) {
        wire::QueryT message;
        message.job = std::make_unique<wire::JobT>();
        message.job->scene = "forest";
        change(*message.job);
        message.ray_count = 1;
        const auto frame = protocol::encode(1, message, daemon.limits).value();
        const auto opened = protocol::open<wire::Query>(frame, daemon.limits);
        REQUIRE(opened);
        return make_plan(daemon.services, {{"me", 1}, 1, 1 << 20}, *(*opened)->job(), query)
            .value();
    };
    const Plan plain = plan([](wire::JobT&) {});
    CHECK(plain.same_call(plan([](wire::JobT& job) { job.priority = "low"; })));
    CHECK_FALSE(plain.same_call(plan([](wire::JobT& job) { job.mask = 1; })));
    CHECK_FALSE(plain.same_call(plan([](wire::JobT& job) { job.traversal = "stream"; })));
    CHECK_FALSE(
        plain.same_call(plan([](wire::JobT& job) { job.intersector = "procedural_mask"; })));
    CHECK_FALSE(plain.same_call(plan([](wire::JobT& job) { job.hidden_instances = {0}; })));
    CHECK_FALSE(plain.same_call(plan([](wire::JobT&) {}, query_any)));
}

}  // namespace
}  // namespace raynest::server
