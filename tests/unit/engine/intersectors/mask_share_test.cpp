// Measures how much of a surface procedural_mask leaves solid.
#include "engine/packs/registry.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

using namespace raynest;

namespace {

/// Returns the share of a grid of rays over the unit square that is stopped.
double solid_share(const std::string& pattern, double fill) {
    static const auto registry = Registry::load({});
    REQUIRE(registry.has_value());
    SceneDescription description;
    description.objects.emplace_back().geometries = {test::unit_square()};
    const auto scene = test::build_scene(description);
    const auto variant = (*registry)->choose("procedural_mask", scene->view());
    REQUIRE(variant.has_value());
    // Noise has one number per cell, so it needs many cells; the others need two on each side.
    const std::vector<std::pair<std::string, std::string>> assignments = {
        {"pattern", pattern},
        {"fill", std::to_string(fill)},
        {"scale", pattern == "noise" ? "256" : "2"}};
    const auto settings = parse_settings(**variant, assignments);
    REQUIRE(settings.has_value());
    const auto function = find_function(**variant, query_any, traversal_single);
    constexpr std::uint32_t side = 256;
    std::vector<Ray> rays(side * side);
    for (std::uint32_t i = 0; i < rays.size(); ++i) {
        rays[i].origin = {(static_cast<float>(i % side) + 0.5F) / side,
                          (static_cast<float>(i / side) + 0.5F) / side, 1};
        rays[i].direction = {0, 0, -1};
    }
    std::vector<HitRecord> hits(rays.size());
    TraceCall call{};
    call.scene = &scene->view();
    call.params = settings->params.data();
    call.rays = rays.data();
    call.ray_count = static_cast<std::uint32_t>(rays.size());
    call.hits_max = 1;
    call.mask = 0xFFFFFFFFU;
    call.flags = settings->flags;
    call.hits = hits.data();
    REQUIRE((*function)(&call) == trace_ok);
    const auto solid =
        std::count_if(hits.begin(), hits.end(), [](const HitRecord& hit) { return hit.hit != 0; });
    return static_cast<double>(solid) / static_cast<double>(hits.size());
}

}  // namespace

TEST_CASE("fill is the share that stays solid, for every pattern") {
    for (const char* pattern : {"heart", "checker", "discs", "noise"}) {
        CAPTURE(pattern);
        CHECK(solid_share(pattern, 0) == 0);
        CHECK(solid_share(pattern, 1) == 1);
        for (const double fill : {0.02, 0.25, 0.5, 0.69, 0.71, 0.78, 0.79, 0.95}) {
            CAPTURE(fill);
            CHECK(std::abs(solid_share(pattern, fill) - fill) < 0.01);
        }
    }
}
