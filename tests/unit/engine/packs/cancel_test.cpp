// Tests callers that cancel: every compiled function ends, even within a ray.
#include "engine/assets/builtin/builtin.h"
#include "engine/packs/registry.h"
#include "engine/scene/snapshot.h"
#include "tests/conformance/scenes.h"

#include <doctest/doctest.h>

#include <cstring>
#include <string>
#include <vector>

using namespace raynest;

namespace {

/// Answers "go on" `patience` times, then "cancel".
struct Caller {
    std::uint64_t patience;
    std::uint64_t asked = 0;

    static bool cancelled(const void* context) noexcept {
        Caller& caller = *static_cast<Caller*>(const_cast<void*>(context));
        return ++caller.asked > caller.patience;
    }
};

struct Outcome {
    TraceStatus status;
    std::vector<HitRecord> hits;
    std::vector<std::uint32_t> counts;
};

Outcome trace(TraceFunction function, Query query, const Snapshot& scene,
              const std::vector<Ray>& rays, Caller* caller) {
    constexpr std::uint32_t most = 4;
    constexpr std::size_t levels_most = 64;  // a scene here has no more
    const std::uint32_t each = query == query_multi || query == query_all ? most : 1;
    Outcome outcome{trace_ok, std::vector<HitRecord>(rays.size() * 2 * most),
                    std::vector<std::uint32_t>(rays.size())};
    std::vector<std::uint8_t> flags(rays.size());
    std::vector<Counters> counters(rays.size() * levels_most);
    std::uint32_t done = 0;
    TraceCall call{};
    call.scene = &scene.view();
    call.rays = rays.data();
    call.ray_count = static_cast<std::uint32_t>(rays.size());
    call.hits_max = each;
    call.mask = 0xFFFFFFFFU;
    call.hits = outcome.hits.data();
    call.hit_counts = outcome.counts.data();
    call.counters = counters.data();
    call.hits_room = outcome.hits.size();
    call.ray_flags = flags.data();
    call.rays_done = &done;
    if (caller != nullptr) {
        call.cancelled = Caller::cancelled;
        call.cancelled_context = caller;
    }
    outcome.status = function(&call);
    return outcome;
}

/// Calls `check(name, function, query)` for every compiled function of an intersector.
template <class Check>
void for_each_function(const Variant& variant, const Check& check) {
    constexpr const char* traversals[] = {"single", "stream", "packet", "reference"};
    constexpr const char* queries[] = {"closest", "any", "multi", "all"};
    std::size_t functions = 0;
    for (std::uint32_t traversal = 0; traversal < traversal_count; ++traversal) {
        for (std::uint32_t query = 0; query < query_count; ++query) {
            for (const std::uint32_t counting : {0U, 1U, 2U}) {
                const TraceFunction function = variant.code->trace[traversal][query][counting];
                if (function == nullptr) continue;
                ++functions;
                check(std::string(traversals[traversal]) + " " + queries[query] +
                          (counting == 0   ? ""
                           : counting == 1 ? " counting"
                                           : " counting by level"),
                      function, static_cast<Query>(query));
            }
        }
    }
    CHECK(functions >= 11);  // those of v2
}

/// Returns rays that tell no box from another, by their tiny directions or their far origins.
std::vector<Ray> rays_that_meet_everything(std::size_t count) {
    std::vector<Ray> rays(count);
    for (std::size_t i = 0; i < count; ++i) {
        const bool far = i % 64 >= 32;
        rays[i].origin = Vec3(far ? 1e30F : 5.0F);
        rays[i].direction = Vec3(far ? -1.0F : -1e-45F);
    }
    return rays;
}

}  // namespace

TEST_CASE("a ray that would never end is cancelled, by every function of every target") {
    // 9^16 spheres: at a nanosecond for each, a ray takes three weeks.
    const auto endless = Snapshot::build(*describe_builtin("builtin:flake?depth=16"));
    REQUIRE(endless.has_value());
    const std::vector<Ray> rays = rays_that_meet_everything(300);
    const auto best = Registry::load({{}, "auto"}).value();
    for (const std::string& target : best->find("opaque")->targets) {
        const auto registry = Registry::load({{}, target}).value();
        for (const char* variant : {"opaque", "alpha_mask"}) {
            for_each_function(*registry->find(variant), [&](const std::string& name,
                                                            TraceFunction function, Query query) {
                CAPTURE(target);
                CAPTURE(variant);
                CAPTURE(name);
                for (const std::uint64_t patience : {0U, 1U, 20U}) {
                    Caller caller{patience};
                    CHECK(trace(function, query, **endless, rays, &caller).status ==
                          trace_cancelled);
                    CHECK(caller.asked == patience + 1);  // and never again
                }
            });
        }
    }
}

TEST_CASE("a caller that never cancels gets the same answer as one without cancellation") {
    const auto scene = Snapshot::build(*describe_builtin("builtin:flake?depth=4"));
    REQUIRE(scene.has_value());
    conformance::Random random(11);
    std::vector<Ray> rays(1500);
    for (Ray& ray : rays) {
        ray.origin = random.in_box(6);
        ray.direction = random.direction();
    }
    const auto registry = Registry::load({{}, "auto"}).value();
    for_each_function(*registry->find("opaque"),
                      [&](const std::string& name, TraceFunction function, Query query) {
                          CAPTURE(name);
                          Caller caller{~0ULL};
                          const Outcome asked = trace(function, query, **scene, rays, &caller);
                          const Outcome alone = trace(function, query, **scene, rays, nullptr);
                          CHECK(asked.status == trace_ok);
                          CHECK(alone.status == trace_ok);
                          CHECK(caller.asked > 0);
                          CHECK(asked.counts == alone.counts);
                          CHECK(std::memcmp(asked.hits.data(), alone.hits.data(),
                                            asked.hits.size() * sizeof(HitRecord)) == 0);
                      });
}
