// Integrators over a caster of a test: they see rays and hits, and no worker.
#include "engine/integrators/ray_caster.h"

#include "engine/integrators/picture.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

using namespace raynest;

namespace {

/// Hits the square [0, 1] x [0, 1] at z = 0, one triangle of it.
class SquareCaster final : public RayCaster {
public:
    bool closest(std::span<const Ray> rays, std::span<HitRecord> hits) override {
        if (calls_left-- == 0) return false;
        for (std::size_t i = 0; i < rays.size(); ++i) {
            hits[i] = {};
            const float t = -rays[i].origin.z / rays[i].direction.z;
            const Vec3 at = rays[i].origin + t * rays[i].direction;
            const bool inside = at.x >= 0 && at.x <= 1 && at.y >= 0 && at.y <= 1;
            if (!inside || t > rays[i].tmax) continue;
            hits[i].hit = hits[i].front = 1;
            hits[i].t = t;
            hits[i].path = 0;
            hits[i].object = hits[i].triangle = 0;
        }
        return true;
    }
    using RayCaster::closest;
    bool occluded(std::span<const Ray> rays, std::span<std::uint8_t> answers) override {
        std::vector<HitRecord> hits(rays.size());
        if (!closest(rays, hits)) return false;
        std::ranges::transform(hits, answers.begin(), &HitRecord::hit);
        return true;
    }
    bool counted(std::span<const Ray> rays, std::span<HitRecord> hits,
                 std::span<Counters> counters) override {
        if (!closest(rays, hits)) return false;
        for (std::size_t i = 0; i < rays.size(); ++i) {
            counters[i] = {};
            // An endless ray looks behind the square, too.
            counters[i].prims = std::isinf(rays[i].tmax) ? 3U : 2U;
        }
        return true;
    }
    bool observed(std::span<const Ray> rays, std::span<HitRecord> hits,
                  const Observer& /*observer*/) override {
        return closest(rays, hits);
    }
    int calls_left = 100;
};

struct SmallPicture {
    explicit SmallPicture(std::uint32_t samples)
        : pixels{camera, 0, std::uint64_t{8} * 8, samples},
          rays(pixels.rays()),
          hits(pixels.rays()),
          counters(pixels.rays()) {}
    [[nodiscard]] PixelArrays arrays() { return {rays, hits, counters}; }

    // Straight down at a window of 2 x 2 around (0, 0): a quarter of it is the square.
    Sensor camera = Orthographic{{{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {0, 0, 5}}}, {8, 8}, 2, 2};
    PixelRange pixels;
    std::vector<Ray> rays;
    std::vector<HitRecord> hits;
    std::vector<Counters> counters;
};

SceneDescription square() {
    SceneDescription scene;
    scene.objects.resize(1);
    scene.objects[0].geometries = {test::unit_square(0)};
    scene.materials.resize(1);
    return scene;
}

}  // namespace

TEST_CASE("the primary integrator asks its caster, and takes the mean of a pixel's samples") {
    const auto scene = test::build_scene(square());
    ColumnSource source;
    source.scene = &scene->view();
    for (const std::uint32_t samples : {1U, 3U, 16U}) {
        SmallPicture picture(samples);
        SquareCaster caster;
        std::vector<Vec4> out(64);
        const auto seen = render_primary(picture.pixels, source, caster, picture.arrays(), out);
        REQUIRE(seen);
        CHECK(seen->rays == 64 * samples);
        CHECK(seen->hits == 16 * samples);
        CHECK(seen->backs == 0);
        CHECK(std::ranges::count_if(out, [](const Vec4& pixel) { return pixel.w == 1; }) == 16);
        // Samples of a pixel differ, and stay in it.
        for (std::uint32_t s = 1; s < samples; ++s) {
            CHECK(picture.rays[s].origin != picture.rays[0].origin);
            CHECK(glm::length(picture.rays[s].origin - picture.rays[0].origin) <= 0.18F);
        }
        caster.calls_left = 0;
        CHECK_FALSE(render_primary(picture.pixels, source, caster, picture.arrays(), out));
    }
}

TEST_CASE("work is summed over a pixel's samples, and the necessary work ends at the hit") {
    const auto scene = test::build_scene(square());
    ColumnSource source;
    source.scene = &scene->view();
    for (const std::uint32_t samples : {1U, 4U}) {
        SmallPicture picture(samples);
        SquareCaster caster;
        std::vector<std::uint32_t> out(64);
        const std::array<Column, 1> metrics = {Field::prims};
        const auto measure = [&](bool necessary) {
            return measure_work(picture.pixels, source, caster, picture.arrays(), metrics,
                                necessary, out);
        };
        REQUIRE(measure(false));
        CHECK(std::ranges::count(out, 3 * samples) == 64);
        REQUIRE(measure(true));
        CHECK(std::ranges::count(out, 2 * samples) == 16);
        CHECK(std::ranges::count(out, 3 * samples) == 48);
        caster.calls_left = 1;
        CHECK_FALSE(measure(true));
    }
}
