// All light of a scene is drawn with the density that Lighting states: chi-squared tests.
#include "engine/integrators/lighting.h"
#include "engine/math/random.h"
#include "tests/unit/engine/integrators/kernel_caster.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <cmath>
#include <numbers>

using namespace raynest;

namespace {

constexpr int samples = 1'000'000;
// As many texels of the sky in each bin, so that steps meet all of them alike.
constexpr int rows = 16, columns = 32;
constexpr std::size_t bins = rows * columns;

std::size_t bin_of(const Vec3& d) {
    const double across = static_cast<double>(std::atan2(d.x, -d.z)) / (2 * std::numbers::pi) + 0.5;
    const double down =
        std::acos(std::clamp(static_cast<double>(d.y), -1.0, 1.0)) / std::numbers::pi;
    const int row = std::clamp(static_cast<int>(down * rows), 0, rows - 1);
    const int column = std::clamp(static_cast<int>(across * columns), 0, columns - 1);
    return static_cast<std::size_t>(row * columns + column);
}

/// A direction within a bin, from two numbers in [0, 1).
Vec3 direction_in(std::size_t bin, double down, double across) {
    const double polar = std::numbers::pi * (static_cast<double>(bin / columns) + down) / rows;
    const double azimuth =
        2 * std::numbers::pi * ((static_cast<double>(bin % columns) + across) / columns - 0.5);
    return Vec3(glm::dvec3(std::sin(polar) * std::sin(azimuth), std::cos(polar),
                           -std::sin(polar) * std::cos(azimuth)));
}

/// Standard deviations by which counts differ from shares of all samples; the last bin takes the
/// rest.
double deviation(const std::vector<double>& counts, std::vector<double> shares) {
    double rest = 1;
    for (const double share : shares) rest -= share;
    shares.push_back(std::max(rest, 0.0));
    double chi = 0, pooled = 0, pooled_expected = 0;
    int degrees = -1;
    const auto add = [&](double count, double expected) {
        chi += (count - expected) * (count - expected) / expected;
        ++degrees;
    };
    for (std::size_t i = 0; i < shares.size(); ++i) {
        const double expected = shares[i] * samples;
        if (expected >= 20) {
            add(counts[i], expected);
            continue;
        }
        pooled += counts[i];
        pooled_expected += expected;
    }
    if (pooled_expected >= 20) add(pooled, pooled_expected);
    return (chi - degrees) / std::sqrt(2.0 * std::max(degrees, 1));
}

/// A scene and its light, seen from the origin.
struct Place {
    Place(const SceneDescription& description, const IntegratorSettings& settings)
        : scene(test::build_scene(description)),
          caster(scene->view()),
          lighting(input(), settings) {}

    IntegratorScene input() const {
        IntegratorScene in{{}, scene->bounds(), &scene->shading()};
        in.source.scene = &scene->view();
        return in;
    }

    /// How often directions are drawn, by bin; the last one counts what is hidden or black.
    std::vector<double> draw() {
        std::vector<double> counts(bins + 1);
        std::vector<Ray> rays;
        Random random(3);
        for (int i = 0; i < samples; ++i) {
            const float choice = random.uniform();
            const float u = random.uniform();
            const LightSample sample = lighting.sample(Vec3(0), choice, {u, random.uniform()});
            Ray ray;
            if (sample.density > 0) {
                ray.direction = sample.ends ? Vec3(sample.end) : sample.direction;
                ray.tmax = sample.ends ? 1.0F : std::numeric_limits<float>::infinity();
            }
            rays.push_back(ray);
        }
        std::vector<std::uint8_t> hidden(rays.size());
        REQUIRE(caster.occluded(rays, hidden));
        for (std::size_t i = 0; i < rays.size(); ++i) {
            const bool counts_none = rays[i].direction == Vec3(0) || hidden[i] != 0;
            ++counts[counts_none ? bins : bin_of(glm::normalize(rays[i].direction))];
        }
        return counts;
    }

    /// The shares of bins that the stated densities predict.
    std::vector<double> predict(int steps) {
        std::vector<double> shares(bins);
        for (std::size_t bin = 0; bin < bins; ++bin) {
            std::vector<Ray> rays;
            for (int y = 0; y < steps; ++y)
                for (int x = 0; x < steps; ++x)
                    rays.push_back(
                        {Vec3(0), 0, direction_in(bin, (y + 0.5) / steps, (x + 0.5) / steps)});
            std::vector<HitRecord> hits(rays.size());
            REQUIRE(caster.closest(rays, hits));
            double sum = 0;
            for (std::size_t i = 0; i < rays.size(); ++i)
                sum += static_cast<double>(density(rays[i], hits[i])) *
                       std::sqrt(1 - std::pow(static_cast<double>(rays[i].direction.y), 2));
            shares[bin] = sum * 2 * std::numbers::pi * std::numbers::pi /
                          static_cast<double>(bins) / (steps * steps);
        }
        return shares;
    }
    float density(const Ray& ray, const HitRecord& hit) const {
        if (hit.hit == 0) return lighting.far(ray.direction).density;
        const Vec3 normal = world_normal(input().source, ray, hit);
        return lighting.triangle_density(hit, hit.t, std::abs(glm::dot(normal, ray.direction)));
    }

    std::shared_ptr<const Snapshot> scene;
    test::KernelCaster caster;
    Lighting lighting;
};

MaterialDescription emitter(float radiance) {
    MaterialDescription material;
    material.base_colour = Vec4(0, 0, 0, 1);
    material.surface.emission = Vec3(radiance);
    return material;
}

/// Two balls and two rectangles around the origin, none before another.
SceneDescription emitters(float first, float second, float third) {
    SceneDescription scene;
    scene.objects.resize(2);
    // A ball of eight triangles: at the edge of a round one the density has no bound.
    GeometryDescription ball;
    ball.positions = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {-1, 0, 0}, {0, -1, 0}, {0, 0, -1}};
    ball.indices = {0, 1, 2, 1, 3, 2, 3, 4, 2, 4, 0, 2, 1, 0, 5, 3, 1, 5, 4, 3, 5, 0, 4, 5};
    ball.material = 0;
    scene.objects[0].geometries = {ball};
    GeometryDescription one = test::unit_square(1), other = test::unit_square(2);
    for (Vec3& p : one.positions) p = {2.5F * p.x - 1, -2, 2.5F * p.y - 1};
    for (Vec3& p : other.positions) p = {-3, 3 * p.x - 1, 2 * p.y + 0.5F};
    scene.objects[1].geometries = {one, other};
    scene.objects[1].instances = {test::place(0, test::translation(3, 2, 0.5F)),
                                  test::place(0, test::translation(0, 1, -4))};
    scene.root = 1;
    scene.materials = {emitter(first), emitter(second), emitter(third)};
    return scene;
}

IntegratorSettings settings_of(IntegratorSettings::Environment environment) {
    IntegratorSettings settings;
    settings.environment = environment;
    return settings;
}

/// An empty place below a picture whose left half is brighter.
IntegratorSettings two_halves(float left, float right) {
    IntegratorSettings settings = settings_of(IntegratorSettings::Environment::picture);
    auto picture = std::make_shared<EnvironmentPicture>();
    picture->size = {72, 36};
    for (std::size_t i = 0; i < 72 * 36; ++i)
        picture->pixels.emplace_back(i % 72 < 36 ? left : right);
    settings.picture = picture;
    return settings;
}

SceneDescription speck() {
    SceneDescription scene;
    scene.objects.resize(1);
    scene.objects[0].geometries = {test::unit_square()};
    for (Vec3& p : scene.objects[0].geometries[0].positions) p = 1e-4F * p + Vec3(0, -50, 0);
    return scene;
}

IntegratorSettings sky_at(float elevation) {
    IntegratorSettings settings = settings_of(IntegratorSettings::Environment::sky);
    settings.sun = true;
    settings.sun_azimuth = 60;
    settings.sun_elevation = elevation;
    return settings;
}

}  // namespace

TEST_CASE("triangles that emit are drawn with the density that is stated, and 5 % off is found") {
    const auto none = settings_of(IntegratorSettings::Environment::none);
    Place place(emitters(2, 3, 5), none);
    const std::vector<double> counts = place.draw();
    CHECK(std::abs(deviation(counts, place.predict(80))) < 5);
    CHECK(deviation(counts, Place(emitters(2, 3 * 1.05F, 5), none).predict(80)) > 20);
}

TEST_CASE("light from near and from far is drawn with the density that is stated") {
    Place place(emitters(2, 3, 5), two_halves(1, 2));
    CHECK(std::abs(deviation(place.draw(), place.predict(80))) < 5);
}

TEST_CASE("pictures of the surroundings: 5 % off is found") {
    Place place(speck(), two_halves(1, 2));
    const std::vector<double> counts = place.draw();
    CHECK(std::abs(deviation(counts, place.predict(16))) < 5);
    CHECK(deviation(counts, Place(speck(), two_halves(1.05F, 2)).predict(16)) > 10);
}

TEST_CASE("the sky is drawn with the density that is stated, and another sky is found") {
    // Below the horizon there is no sun; the twilight is brighter in the west.
    Place place(speck(), sky_at(-3));
    const std::vector<double> counts = place.draw();
    CHECK(std::abs(deviation(counts, place.predict(16))) < 5);
    IntegratorSettings other = sky_at(-3);
    other.sun_azimuth *= 1.05F;
    CHECK(deviation(counts, Place(speck(), other).predict(16)) > 10);
}

TEST_CASE(
    "the sun's disc is drawn with the density that is stated, and a disc 5 % larger is found") {
    const SunDisc sun = make_sky(60, 30).sun;
    Random random(9);
    // Rings of equal solid angle, and sixteen sectors.
    constexpr std::size_t rings = 16, sectors = 16;
    const auto count = [&](const SunDisc& drawn) {
        std::vector<double> counts(rings * sectors + 1);
        const Basis frame = basis_around(sun.direction);
        for (int i = 0; i < samples; ++i) {
            const float u = random.uniform();
            const Vec3 d = frame.to_local(drawn.sample({u, random.uniform()}));
            // The cosine has too few digits in float: 1 - cos is half of the sine's square.
            const double sine2 = static_cast<double>(d.x) * static_cast<double>(d.x) +
                                 static_cast<double>(d.y) * static_cast<double>(d.y);
            const double ring =
                sine2 / 2 * 2 * std::numbers::pi * static_cast<double>(sun.density()) * rings;
            const double turn =
                static_cast<double>(std::atan2(d.y, d.x)) / (2 * std::numbers::pi) + 0.5;
            const auto sector = std::min(static_cast<std::size_t>(turn * sectors), sectors - 1);
            ++counts[ring < rings ? static_cast<std::size_t>(ring) * sectors + sector
                                  : rings * sectors];
        }
        return counts;
    };
    const std::vector<double> shares(rings * sectors, 1.0 / (rings * sectors));
    CHECK(std::abs(deviation(count(sun), shares)) < 5);
    SunDisc larger = sun;
    larger.cosine = 1 - 1.05F * (1 - sun.cosine);
    CHECK(deviation(count(larger), shares) > 20);
    // A draw of all light has its density, too.
    Place place(speck(), sky_at(30));
    const float there = place.lighting.far(sun.direction).density;
    const float beside = place.lighting.far(from_azimuth(1.0F, 0.5F)).density;
    CHECK(there > 0.49F * sun.density());
    CHECK(beside < 10);
}
