// Fast and high builds give other trees but the same answers. A high build cuts triangles into
// parts with boxes of their own, so rays are aimed where a part could be missed: at edges and
// vertices, and along the planes of triangles.
#include "engine/bvh/build.h"
#include "engine/geometry/triangle.h"
#include "engine/packs/registry.h"
#include "engine/scene/format.h"
#include "engine/scene/snapshot.h"
#include "tests/conformance/scenes.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <numeric>
#include <set>
#include <string>
#include <vector>

using namespace raynest;
using conformance::needles;

namespace {

std::shared_ptr<const Snapshot> built(SceneDescription scene, BuildQuality build) {
    scene.build = build;
    const auto snapshot = Snapshot::build(scene);
    REQUIRE(snapshot.has_value());
    return *snapshot;
}

/// Returns rays through points of random triangles, along their planes except for rounding and a
/// little more.
std::vector<Ray> grazing_rays(const SceneDescription& scene, std::uint32_t count,
                              conformance::Random& random) {
    const GeometryDescription& geometry = scene.objects[0].geometries[0];
    std::vector<Ray> rays(count);
    for (Ray& ray : rays) {
        const Vec3* const v = &geometry.positions[3 * random.below(static_cast<std::uint32_t>(
                                                          geometry.positions.size() / 3))];
        const float a = random.unit(), b = random.unit() * (1 - a);
        const Vec3 e1 = v[1] - v[0], e2 = v[2] - v[0];
        const Vec3 point = v[0] + a * e1 + b * e2;
        const Vec3 within = random.between(-1, 1) * e1 + random.between(-1, 1) * e2;
        const float tilt = std::pow(10.0F, random.between(-8, -1));
        const Vec3 direction =
            glm::normalize(within) + tilt * (random.below(4) == 0 ? Vec3(0) : random.direction());
        ray.origin = point - random.between(1, 20) * direction;
        ray.direction = direction;
    }
    return rays;
}

std::vector<HitRecord> trace(const Variant& variant, const Snapshot& scene, Traversal traversal,
                             const std::vector<Ray>& rays) {
    const auto function = find_function(variant, query_closest, traversal);
    REQUIRE(function.has_value());
    std::vector<HitRecord> hits(rays.size());
    const TraceCall call{&scene.view(),
                         nullptr,
                         rays.data(),
                         static_cast<std::uint32_t>(rays.size()),
                         1,
                         0xFFFFFFFFU,
                         0,
                         hits.data(),
                         nullptr,
                         nullptr,
                         nullptr};
    (*function)(&call);
    return hits;
}

/// Hits as a request receives them: count per ray, truncation per ray, and all hits.
struct All {
    std::vector<std::uint32_t> counts;
    std::vector<std::uint8_t> flags;
    std::vector<HitRecord> hits;
};

All trace_all(const Variant& variant, const Snapshot& scene, Traversal traversal,
              std::uint32_t budget, const std::vector<Ray>& rays) {
    const auto function = find_function(variant, query_all, traversal);
    REQUIRE(function.has_value());
    All all{std::vector<std::uint32_t>(rays.size()), std::vector<std::uint8_t>(rays.size()),
            std::vector<HitRecord>(rays.size() * 32)};
    std::uint32_t done = 0;
    TraceCall call{};
    call.scene = &scene.view();
    call.rays = rays.data();
    call.ray_count = static_cast<std::uint32_t>(rays.size());
    call.hits_max = budget;
    call.mask = 0xFFFFFFFFU;
    call.hits = all.hits.data();
    call.hit_counts = all.counts.data();
    call.hits_room = all.hits.size();
    call.ray_flags = all.flags.data();
    call.rays_done = &done;
    REQUIRE((*function)(&call) == trace_ok);
    REQUIRE(done == rays.size());
    all.hits.resize(std::accumulate(all.counts.begin(), all.counts.end(), std::size_t{0}));
    return all;
}

/// Returns the first `budget` hits of each ray, in the form of All.
All trace_multi(const Variant& variant, const Snapshot& scene, Traversal traversal,
                std::uint32_t budget, const std::vector<Ray>& rays) {
    const auto function = find_function(variant, query_multi, traversal);
    REQUIRE(function.has_value());
    std::vector<HitRecord> room(rays.size() * budget);
    All multi{std::vector<std::uint32_t>(rays.size()), {}, {}};
    TraceCall call{};
    call.scene = &scene.view();
    call.rays = rays.data();
    call.ray_count = static_cast<std::uint32_t>(rays.size());
    call.hits_max = budget;
    call.mask = 0xFFFFFFFFU;
    call.hits = room.data();
    call.hit_counts = multi.counts.data();
    REQUIRE((*function)(&call) == trace_ok);
    for (std::size_t i = 0; i < rays.size(); ++i) {
        const auto first = room.begin() + static_cast<std::ptrdiff_t>(i * budget);
        multi.hits.insert(multi.hits.end(), first, first + multi.counts[i]);
    }
    return multi;
}

/// Returns the number of rays of each kind, which RAYNEST_SPATIAL_RAYS sets.
std::uint32_t ray_count() {
    const char* const text = std::getenv("RAYNEST_SPATIAL_RAYS");
    return text != nullptr ? static_cast<std::uint32_t>(std::stoul(text)) : 20'000;
}

}  // namespace

TEST_CASE("fast and high builds give the brute-force answers, at edges and along planes") {
    const auto registry = Registry::load({{}, "auto"});
    REQUIRE(registry.has_value());
    const Variant& opaque = *(*registry)->find("opaque");
    conformance::Random random(11);
    const SceneDescription description = needles(150, 5);
    const auto medium = built(description, BuildQuality::medium);
    auto rays = conformance::edge_rays(description, ray_count(), 8, random);
    const auto grazing = grazing_rays(description, ray_count(), random);
    rays.insert(rays.end(), grazing.begin(), grazing.end());
    // Start where the box test's own tolerance, which grows with the ray's origin, is almost zero.
    for (std::uint32_t i = 0; i < ray_count(); ++i) {
        Ray& ray = rays.emplace_back();
        ray.origin = random.in_box(1e-4F);
        ray.direction = conformance::random_edge_point(description, random) - ray.origin;
    }

    const auto expected = trace(opaque, *medium, traversal_reference, rays);
    CHECK(std::count_if(expected.begin(), expected.end(), [](const HitRecord& hit) {
              return hit.hit != 0;
          }) > static_cast<std::ptrdiff_t>(rays.size() / 4));
    for (const BuildQuality build : {BuildQuality::fast, BuildQuality::high}) {
        CAPTURE(build_quality_names[static_cast<std::size_t>(build)]);
        const auto hits = trace(opaque, *built(description, build), traversal_single, rays);
        std::size_t different = 0;
        for (std::size_t i = 0; i < rays.size(); ++i) {
            different += std::size_t{std::memcmp(&hits[i], &expected[i], sizeof hits[i]) != 0};
        }
        CHECK(different == 0);
    }
}

TEST_CASE("all reports each hit once, though a high build puts a triangle into several leaves") {
    const auto registry = Registry::load({{}, "auto"});
    REQUIRE(registry.has_value());
    const Variant& opaque = *(*registry)->find("opaque");
    conformance::Random random(12);
    const SceneDescription description = needles(600, 5);
    const auto rays = grazing_rays(description, 5000, random);
    const auto medium = built(description, BuildQuality::medium);
    const auto high = built(description, BuildQuality::high);
    for (const std::uint32_t budget : {2U, 1000U}) {
        CAPTURE(budget);
        const All expected = trace_all(opaque, *medium, traversal_reference, budget, rays);
        const All all = trace_all(opaque, *high, traversal_single, budget, rays);
        CHECK(all.counts == expected.counts);
        CHECK(all.flags == expected.flags);
        REQUIRE(all.hits.size() == expected.hits.size());
        CHECK(std::memcmp(all.hits.data(), expected.hits.data(),
                          all.hits.size() * sizeof(HitRecord)) == 0);
        const auto cut = std::count(all.flags.begin(), all.flags.end(), hit_truncated);
        CHECK((cut > 0) == (budget == 2));
        CHECK(*std::max_element(all.counts.begin(), all.counts.end()) > (budget == 2 ? 1 : 3));
    }
}

TEST_CASE("multi reports the first hits of all once, though several leaves hold a triangle") {
    const auto registry = Registry::load({{}, "auto"});
    REQUIRE(registry.has_value());
    const Variant& opaque = *(*registry)->find("opaque");
    conformance::Random random(13);
    const SceneDescription description = needles(600, 5);
    const auto rays = grazing_rays(description, 5000, random);
    const auto high = built(description, BuildQuality::high);
    for (const std::uint32_t budget : {2U, 8U}) {
        const All expected = trace_all(opaque, *high, traversal_single, budget, rays);
        for (const Traversal traversal : {traversal_single, traversal_stream}) {
            if (!find_function(opaque, query_multi, traversal)) continue;
            CAPTURE(budget);
            CAPTURE(traversal);
            const All multi = trace_multi(opaque, *high, traversal, budget, rays);
            CHECK(multi.counts == expected.counts);
            REQUIRE(multi.hits.size() == expected.hits.size());
            CHECK(std::memcmp(multi.hits.data(), expected.hits.data(),
                              multi.hits.size() * sizeof(HitRecord)) == 0);
        }
    }
}

TEST_CASE("a high build cuts overlapping triangles within its budget, and is cheaper to trace") {
    const SceneDescription description = needles(2000, 6);
    const auto medium = built(description, BuildQuality::medium);
    const auto high = built(description, BuildQuality::high);
    const auto* blocks =
        format::section<TriangleBlock>(high->bytes().data(), format::Section::blocks);
    std::set<std::uint32_t> named;
    std::size_t references = 0;
    for (std::uint64_t b = 0; b < high->statistics().leaf_blocks; ++b) {
        std::set<std::uint32_t> in_block;
        for (const std::uint32_t triangle : blocks[b].triangle) {
            if (triangle == no_id) continue;
            CHECK(in_block.insert(triangle).second);
            named.insert(triangle);
            ++references;
        }
    }
    CHECK(named.size() == 2000);
    CHECK(references > 2200);
    CHECK(references <= 3000);
    CHECK(high->statistics().trees.sah_cost < 0.97 * medium->statistics().trees.sah_cost);
    CHECK(high->statistics().build == BuildQuality::high);
}

TEST_CASE("a fast build loses little on scattered triangles") {
    SceneDescription description = conformance::sheet_scene(4096, 1, 3);
    const auto medium = built(description, BuildQuality::medium);
    const auto fast = built(description, BuildQuality::fast);
    CHECK(fast->statistics().trees.sah_cost < 1.5 * medium->statistics().trees.sah_cost);
    CHECK(fast->statistics().trees.sah_cost != medium->statistics().trees.sah_cost);
}
