// Plans: which requests a common call may answer.
#include "server/execution/plan.h"

#include "server/execution/kept_selections.h"
#include "server/requests/words/make_plan.h"
#include "tests/unit/server/small_daemon.h"

#include <doctest/doctest.h>

#include <functional>
#include <memory>
#include <string>

namespace raynest::server {
namespace {

/// Returns the plan of a query for a ray.
Plan plan_of(test::SmallDaemon& daemon, const std::function<void(wire::JobT&)>& change,
             Query query = query_closest, const std::string& principal = "me") {
    wire::QueryT message;
    message.job = std::make_unique<wire::JobT>();
    message.job->scene = "forest";
    change(*message.job);
    message.ray_count = 1;
    const auto frame = protocol::encode(1, message, daemon.limits).value();
    const auto opened = protocol::open<wire::Query>(frame, daemon.limits);
    REQUIRE(opened);
    return make_plan(daemon.services, {{principal, 1}, 1, 1 << 20}, job_words(*(*opened)->job()),
                     query)
        .value();
}

TEST_CASE("a common call answers requests that differ in nothing that decides hits") {
    test::SmallDaemon daemon;
    const auto plan = [&](const std::function<void(wire::JobT&)>& change,
                          Query query = query_closest) { return plan_of(daemon, change, query); };
    const Plan plain = plan([](wire::JobT&) {});
    CHECK(plain.same_call(plan([](wire::JobT& job) { job.priority = "low"; })));
    CHECK_FALSE(plain.same_call(plan([](wire::JobT& job) { job.mask = 1; })));
    CHECK_FALSE(plain.same_call(plan([](wire::JobT& job) { job.traversal = "stream"; })));
    CHECK_FALSE(
        plain.same_call(plan([](wire::JobT& job) { job.intersector = "procedural_mask"; })));
    CHECK_FALSE(plain.same_call(plan([](wire::JobT& job) { job.hidden_instances = {0}; })));
    CHECK_FALSE(plain.same_call(plan([](wire::JobT&) {}, query_any)));
}

TEST_CASE("a principal that hides the same again takes the view that is there") {
    test::SmallDaemon daemon;
    KeptSelections kept(daemon.services.blocking);
    daemon.services.selections = &kept;
    const auto hiding = [&](const std::string& path, const std::string& principal = "me") {
        return plan_of(
            daemon, [&](wire::JobT& job) { job.hidden_paths = {path}; }, query_closest, principal);
    };
    const StopFlag stop(Clock::time_point::max());
    std::uint64_t bytes = 0;
    {
        const Plan first = hiding("second/low");
        CHECK(first.needs_select());
        REQUIRE(first.select(stop));
        CHECK(!first.needs_select());
        // Objects are shared: the second twig has records of its own.
        CHECK(first.selected->has_copies());
        bytes = first.selected->bytes();
        CHECK(daemon.budget.held_by("me") == bytes);
        CHECK(kept.held_by("me") == 0);  // the plan holds it

        const Plan again = hiding("second/low");
        CHECK(!again.needs_select());
        CHECK(again.same_call(first));
        CHECK(daemon.budget.held_by("me") == bytes);
        CHECK(!hiding("second/low", "you").same_call(first));
        CHECK(!hiding("first/low").same_call(first));
        Plan boxes = plan_of(daemon, [](wire::JobT& job) {
            job.hidden_paths = {"second/low"};
            job.skip_hidden_boxes = true;
        });
        CHECK(!boxes.same_call(first));
    }
    CHECK(daemon.metrics.selections_made == 4);
    CHECK(daemon.metrics.selections_reused == 1);
    CHECK(kept.held_by("me") >= bytes);
    CHECK(kept.held_by("you") > 0);

    // One that failed does not stay.
    {
        const Plan failed = hiding("nowhere");
        const auto refused = failed.select(stop);
        REQUIRE(!refused);
        CHECK(refused.error().code == Code::invalid_field);
        CHECK(!hiding("nowhere").same_call(failed));
    }

    // The last four stay, of each principal.
    const auto yours = kept.held_by("you");
    for (int i = 0; i < 20; ++i)
        REQUIRE(hiding("*" + std::string(static_cast<std::size_t>(i), '*')).select(stop));
    CHECK(daemon.budget.held_by("me") <= 4 * bytes + 4096);
    CHECK(kept.held_by("you") == yours);
    CHECK(daemon.metrics.selections_reused == 1);
    kept.drop("me");
    CHECK(daemon.budget.held_by("me") == 0);
    CHECK(daemon.budget.held_by("you") == yours);

    // A scene that is gone takes its views with it.
    (void)hiding("first");
    daemon.scenes.publish("forest", test::square(1), {.replace = true}, {"owner", 1}).value();
    kept.drop_idle();
    CHECK(daemon.budget.held_by("me") == 0);
    // A scene that is one mesh has no instances.
    const Plan mesh = plan_of(daemon, [](wire::JobT& job) { job.hidden_path_ids = {0}; });
    REQUIRE(mesh.select(stop));
    CHECK(daemon.budget.held_by("me") == mesh.selected->bytes());
}

/// The intersector that Started names for a request.
template <class Request>
std::string chosen(test::SmallDaemon& daemon, Request request) {
    request.job = std::make_unique<wire::JobT>();
    request.job->scene = "pane";
    daemon.sent.clear();
    test::Client client(daemon);
    client.receive(test::frame_of(0, wire::HelloT{}));
    client.receive(test::frame_of(1, request));
    daemon.settle();
    for (const protocol::Frame& frame : daemon.sent)
        if (const auto started = protocol::open<wire::Started>(frame))
            return (*started)->intersector()->str();
    return "";
}

TEST_CASE("lit pictures blend by themselves, and queries and counts do not") {
    test::SmallDaemon daemon;
    SceneDescription pane;
    pane.objects.resize(1);
    pane.objects[0].geometries = {test::unit_square(0)};
    pane.materials.resize(1);
    pane.materials[0].alpha_mode = AlphaMode::blend;
    daemon.scenes.publish("pane", test::build_scene(pane), {.share = {"public"}}, {"owner", 1})
        .value();
    const auto sized = [](auto request) {
        request.width = request.height = 4;
        request.encode = "raw";
        request.camera = test::from_above();
        return request;
    };
    wire::RenderT lit = sized(wire::RenderT{});
    for (const char* integrator : {"ao", "direct", "path"}) {
        lit.integrator = integrator;
        CHECK(chosen(daemon, lit) == "alpha_blend");
    }
    lit.encode = "path+1,1";
    CHECK(chosen(daemon, lit) == "alpha_blend");
    CHECK(chosen(daemon, sized(wire::RenderT{})) == "opaque");
    CHECK(chosen(daemon, sized(wire::HeatmapT{})) == "opaque");
    wire::QueryT query;
    query.ray_count = 1;
    CHECK(chosen(daemon, query) == "opaque");
}

}  // namespace
}  // namespace raynest::server
