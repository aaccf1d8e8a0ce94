// Lights: they are drawn with the density that they state, and send what their units say.
#include "engine/shading/lights.h"

#include "engine/math/random.h"
#include "engine/scene/checks/shading_check.h"
#include "engine/shading/alias_table.h"
#include "engine/shading/sky.h"
#include "engine/shading/types.h"

#include <doctest/doctest.h>

#include <cmath>
#include <numbers>
#include <vector>

using namespace raynest;

namespace {

LightRecord light_at(const Vec3& position, float candela) {
    LightRecord light;
    light.position = position;
    light.direction = {0, -1, 0};
    light.intensity = Vec3(candela);
    return light;
}

}  // namespace

TEST_CASE("an alias table draws entries in proportion to their weights") {
    const std::vector<float> weights = {1, 0, 3, 0.5F, 5.5F, 0};
    const AliasTable table(weights);
    CHECK(table.total() == 10);
    std::vector<int> counts(weights.size());
    constexpr int samples = 100000;
    for (int i = 0; i < samples; ++i)
        ++counts[table.draw((static_cast<float>(i) + 0.5F) / samples)];
    for (std::size_t i = 0; i < weights.size(); ++i)
        CHECK(counts[i] ==
              doctest::Approx(static_cast<double>(weights[i]) * samples / 10).epsilon(0.001));
    CHECK(AliasTable(std::vector<float>{0, 0}).empty());
    CHECK(AliasTable(std::vector<float>{}).empty());
}

TEST_CASE("an environment is drawn with the density that it states") {
    constexpr std::uint32_t width = 32, height = 16;
    Random random(5);
    std::vector<Vec3> pixels(width * height);
    for (Vec3& p : pixels) p = Vec3(std::pow(random.uniform(), 8.0F) * 100);
    pixels[100] = Vec3(std::nanf(""));
    pixels[101] = Vec3(-3);
    // Turned by a share of a pixel, so that no edge of a column stays where it was.
    constexpr float middle = 0.3F;
    const Environment environment(width, height, pixels, middle);
    constexpr int samples = 1'000'000;
    std::vector<double> counts(width * height), expected(width * height);
    const auto bin = [&](const Vec3& d) {
        const double turns = static_cast<double>(std::atan2(d.x, -d.z)) / (2 * std::numbers::pi) +
                             0.5 - static_cast<double>(middle);
        const double across = turns - std::floor(turns);
        const double down =
            std::acos(std::clamp(static_cast<double>(d.y), -1.0, 1.0)) / std::numbers::pi;
        const auto column = std::min(static_cast<std::uint32_t>(across * width), width - 1);
        const auto row = std::min(static_cast<std::uint32_t>(down * height), height - 1);
        return std::size_t{row} * width + column;
    };
    double irradiance = 0;
    for (int i = 0; i < samples; ++i) {
        float density = 0;
        const float u = random.uniform();
        const Vec3 d = environment.sample({u, random.uniform()}, density);
        REQUIRE(density > 0);
        ++counts[bin(d)];
        irradiance +=
            static_cast<double>(environment.radiance(d).x * std::max(d.y, 0.0F) / density);
    }
    constexpr int steps = 8;
    double chi = 0;
    int degrees = -1;
    for (std::uint32_t y = 0; y < height; ++y) {
        for (std::uint32_t x = 0; x < width; ++x) {
            double sum = 0;
            for (int sy = 0; sy < steps; ++sy) {
                const double polar = std::numbers::pi * (y + (sy + 0.5) / steps) / height;
                const double around =
                    2 * std::numbers::pi * ((x + 0.5) / width - 0.5 + static_cast<double>(middle));
                sum += std::sin(polar) * static_cast<double>(environment.density(Vec3(glm::dvec3(
                                             std::sin(polar) * std::sin(around), std::cos(polar),
                                             -std::sin(polar) * std::cos(around)))));
            }
            const double share =
                sum / steps * 2 * std::numbers::pi * std::numbers::pi / width / height;
            const double count = counts[std::size_t{y} * width + x];
            if (share * samples < 20) continue;
            chi += (count - share * samples) * (count - share * samples) / (share * samples);
            ++degrees;
        }
    }
    CHECK(std::abs(chi - degrees) / std::sqrt(2.0 * degrees) < 5);
    CHECK(
        irradiance / samples ==
        doctest::Approx(static_cast<double>(environment.irradiance_up().x)).epsilon(0.02).scale(0));
    CHECK(Environment().empty());
    float density = 1;
    static_cast<void>(Environment(2, 1, std::vector<Vec3>(2)).sample({0.5F, 0.5F}, density));
    CHECK(density == 0);
}

TEST_CASE("a light's own numbers have the defaults of its kind, and are checked by their ranges") {
    LightRecord light = light_at({}, 1);
    set_kind(light, *light_kind("spot"));
    CHECK(light_numbers(light.kind).size() == 2);
    CHECK(*light_number(light, "inner_cosine") == 1);
    CHECK(*light_number(light, "outer_cosine") == doctest::Approx(std::sqrt(0.5)));
    CHECK(light_number(light, "gain") == nullptr);
    CHECK(is_sound(light));
    *light_number(light, "outer_cosine") = -1.5F;
    CHECK(!is_sound(light));
    // Numbers that a kind does not name are 0: equal lights have equal bytes.
    set_kind(light, *light_kind("point"));
    CHECK(light.own[0] == 0);
    CHECK(is_sound(light));
    light.own[3] = 1;
    CHECK(!is_sound(light));
}

TEST_CASE("punctual lights send candela and lux") {
    const Vec3 from(0, 0, 0);
    const LightSample point = PointLight::sample(light_at({0, 3, 4}, 50), from, {});
    CHECK(point.radiance.x == doctest::Approx(2));
    CHECK(point.distance == doctest::Approx(5));
    LightRecord ranged = light_at({0, 3, 4}, 50);
    ranged.range = 5;
    CHECK(PointLight::sample(ranged, from, {}).radiance.x == 0);
    // Half way the fade has lost a sixteenth.
    ranged.range = 10;
    CHECK(PointLight::sample(ranged, from, {}).radiance.x == doctest::Approx(2 * 15.0 / 16));

    LightRecord spot = light_at({0, 2, 0}, 8);
    spot.own[0] = std::cos(0.3F);
    spot.own[1] = std::cos(0.6F);
    CHECK(SpotLight::sample(spot, from, {}).radiance.x == doctest::Approx(2));
    CHECK(SpotLight::sample(spot, {5, 0, 0}, {}).radiance.x == 0);
    const float beside = 2 * std::tan(0.45F);
    const float part =
        SpotLight::sample(spot, {beside, 0, 0}, {}).radiance.x * (4 + beside * beside) / 8;
    const float linear = (std::cos(0.45F) - spot.own[1]) / (spot.own[0] - spot.own[1]);
    CHECK(part == doctest::Approx(linear * linear).epsilon(1e-4).scale(0));

    const LightSample sun = DirectionalLight::sample(light_at({}, 7), from, {});
    CHECK(sun.radiance.x == 7);
    CHECK(sun.direction == Vec3(0, 1, 0));
}

TEST_CASE("the sky is bright and blue by day, red at dusk, dark at night") {
    const Sky noon = make_sky(180, 60);
    const Vec3 zenith = noon.environment.radiance({0, 1, 0});
    CHECK(zenith.z > zenith.x);
    CHECK(noon.sun.radiance.x > 0);
    const Vec3 sun_irradiance = noon.sun.radiance / noon.sun.density();
    const Vec3 sky_irradiance = noon.environment.irradiance_up();
    // By day the sun gives some times the light of a clear sky; the model's sky is on the bright
    // side.
    const float ratio = brightness(sun_irradiance) * std::sin(pi / 3) / brightness(sky_irradiance);
    CHECK(ratio > 2);
    CHECK(ratio < 10);
    // A white surface that faces the sun has a radiance near 1.
    const float white = brightness(sun_irradiance + sky_irradiance) / pi;
    CHECK(white > 0.5F);
    CHECK(white < 2);

    const Sky evening = make_sky(270, 2);
    CHECK(evening.sun.radiance.x > 2 * evening.sun.radiance.z);
    CHECK(evening.sun.direction.x < -0.9F);
    const Sky night = make_sky(0, -30);
    CHECK(is_black(night.sun.radiance));
    CHECK(is_black(night.environment.radiance({0, 1, 0})));
    for (const float elevation : {90.0F, 45.0F, 0.0F, -10.0F, -90.0F}) {
        const Sky sky = make_sky(30, elevation);
        for (const Vec3& d : {Vec3(0, 1, 0), Vec3(1, 0, 0), Vec3(0, -1, 0)}) {
            const Vec3 radiance = sky.environment.radiance(d);
            CHECK(std::isfinite(radiance.x + radiance.y + radiance.z));
        }
    }
    // The ground sends on what sun and sky send down, whatever the sun's height.
    const auto ground_share = [](float elevation) {
        const Sky sky = make_sky(30, elevation);
        const float down =
            brightness(sky.environment.irradiance_up()) +
            brightness(sky.sun.radiance / sky.sun.density()) * std::sin(elevation * pi / 180);
        return brightness(sky.environment.radiance({0, -1, 0})) * pi / down;
    };
    for (const float elevation : {5.0F, 20.0F, 60.0F, 85.0F})
        CHECK(ground_share(elevation) == doctest::Approx(0.2).epsilon(0.01).scale(0));
    // Drawn directions lie on the disc.
    Random random(2);
    for (int i = 0; i < 1000; ++i) {
        const float u = random.uniform();
        CHECK(noon.sun.contains(noon.sun.sample({u * 0.99F, random.uniform()})));
    }
}
