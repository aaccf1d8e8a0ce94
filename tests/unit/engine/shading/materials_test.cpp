// Materials: they neither make nor lose light, look the same both ways, and draw directions as they
// say.
#include "engine/shading/materials.h"

#include "engine/math/random.h"
#include "engine/shading/types.h"

#include <doctest/doctest.h>

#include <cmath>
#include <numbers>
#include <vector>

using namespace raynest;

namespace {

/// A direction with this cosine.
Vec3 direction(float cosine, float azimuth = 0.7F) {
    const float sine = std::sqrt(1 - cosine * cosine);
    return {sine * std::cos(azimuth), sine * std::sin(azimuth), cosine};
}

MaterialPoint white(float roughness, float metallic) {
    MaterialPoint point;
    point.roughness = roughness;
    point.metallic = metallic;
    return point;
}

MaterialPoint glass(float roughness, bool solid, bool inside = false) {
    MaterialPoint point = white(roughness, 0);
    point.transmission = 1;
    point.solid = solid;
    point.inside = inside;
    return point;
}

/// The share of uniform light that a material sends to `outgoing`, drawn as a path tracer does.
template <class Material = Standard>
double furnace(const MaterialPoint& point, const Vec3& outgoing, int samples = 1 << 16) {
    const Material material(point, outgoing);
    Random random(7);
    double sum = 0;
    for (int i = 0; i < samples; ++i) {
        const float choice = random.uniform();
        const Vec2 u(random.uniform(), random.uniform());
        const Vec3 incoming = material.sample(choice, u);
        if (incoming == Vec3(0)) continue;
        const float density = material.density(incoming);
        if (density > 0) sum += static_cast<double>(material.evaluate(incoming).y / density);
    }
    return sum / samples;
}

/// Standard deviations by which counts of drawn directions differ from what a density predicts.
template <class Material = Standard>
double deviation(const MaterialPoint& drawn, const MaterialPoint& stated, const Vec3& outgoing,
                 int samples = 1'000'000) {
    constexpr int rows = 40, columns = 40, steps = 16;
    const Material source(drawn, outgoing);
    const Material density(stated, outgoing);
    std::vector<double> counts(rows * columns + 1), expected(rows * columns + 1);
    Random random(11);
    for (int i = 0; i < samples; ++i) {
        const float choice = random.uniform();
        const Vec2 u(random.uniform(), random.uniform());
        const Vec3 d = source.sample(choice, u);
        if (d == Vec3(0)) {
            ++counts.back();
            continue;
        }
        const double azimuth =
            static_cast<double>(std::atan2(d.y, d.x)) / (2 * std::numbers::pi) + 0.5;
        const int row =
            std::min(static_cast<int>((d.z + 1) / 2 * static_cast<float>(rows)), rows - 1);
        const int column = std::min(static_cast<int>(azimuth * columns), columns - 1);
        ++counts[static_cast<std::size_t>(row * columns + column)];
    }
    double all = 0;
    for (int row = 0; row < rows; ++row) {
        for (int column = 0; column < columns; ++column) {
            double sum = 0;
            for (int y = 0; y < steps; ++y) {
                for (int x = 0; x < steps; ++x) {
                    const double z = 2 * (row + (y + 0.5) / steps) / rows - 1;
                    const double a =
                        2 * std::numbers::pi * ((column + (x + 0.5) / steps) / columns - 0.5);
                    const double s = std::sqrt(1 - z * z);
                    sum += static_cast<double>(
                        density.density(Vec3(glm::dvec3(s * std::cos(a), s * std::sin(a), z))));
                }
            }
            sum *= 4 * std::numbers::pi / (rows * columns) / (steps * steps);
            expected[static_cast<std::size_t>(row * columns + column)] = sum * samples;
            all += sum;
        }
    }
    expected.back() = std::max(1 - all, 0.0) * samples;
    // Pool bins that expect little.
    double chi = 0, pooled = 0, pooled_expected = 0;
    int degrees = -1;
    for (std::size_t i = 0; i < counts.size(); ++i) {
        if (expected[i] < 20) {
            pooled += counts[i];
            pooled_expected += expected[i];
            continue;
        }
        chi += (counts[i] - expected[i]) * (counts[i] - expected[i]) / expected[i];
        ++degrees;
    }
    if (pooled_expected > 20) {
        chi += (pooled - pooled_expected) * (pooled - pooled_expected) / pooled_expected;
        ++degrees;
    }
    return (chi - degrees) / std::sqrt(2.0 * degrees);
}

MaterialPoint coated(float roughness, float metallic, float coat_roughness) {
    MaterialPoint point = white(roughness, metallic);
    point.layers.clearcoat = 1;
    point.layers.clearcoat_roughness = coat_roughness;
    return point;
}

MaterialPoint cloth(float roughness, const Vec3& colour = Vec3(1)) {
    MaterialPoint point = white(1, 0);
    point.layers.sheen = colour;
    point.layers.sheen_roughness = roughness;
    return point;
}

MaterialPoint brushed(float roughness, float metallic, float strength) {
    MaterialPoint point = white(roughness, metallic);
    point.layers.anisotropy = strength;
    point.along = {std::cos(0.5F), std::sin(0.5F)};
    return point;
}

/// One with every layer.
MaterialPoint all_layers() {
    MaterialPoint point = coated(0.4F, 0.5F, 0.2F);
    point.layers.clearcoat = 0.7F;
    point.layers.sheen = {0.2F, 0.5F, 0.1F};
    point.layers.sheen_roughness = 0.4F;
    point.layers.specular = 0.6F;
    point.layers.specular_colour = {1, 0.5F, 0.2F};
    point.layers.anisotropy = 0.6F;
    point.coat_normal = direction(0.95F, 2);
    point.base_colour = {0.8F, 0.6F, 0.3F};
    return point;
}

}  // namespace

TEST_CASE("white furnace: opaque materials reflect all light at any roughness") {
    for (const float roughness : {0.03F, 0.1F, 0.2F, 0.35F, 0.5F, 0.7F, 0.85F, 1.0F}) {
        for (const float metallic : {0.0F, 0.5F, 1.0F}) {
            for (const float cosine : {1.0F, 0.8F, 0.5F, 0.25F, 0.1F}) {
                CAPTURE(roughness);
                CAPTURE(metallic);
                CAPTURE(cosine);
                const double sum = furnace(white(roughness, metallic), direction(cosine));
                CHECK(std::abs(sum - 1) < 0.005);
            }
        }
    }
}

TEST_CASE("furnace: a metal that absorbs has its closed form") {
    // One bounce f, all others: f times a geometric series of the mean.
    MaterialPoint point = white(0.6F, 1);
    point.base_colour = Vec3(0.5F);
    const AlbedoTables& t = albedo_tables();
    for (const float cosine : {0.9F, 0.4F}) {
        const float full = t.full.at(cosine, 0.6F);
        const float edge = t.edge.at(cosine, 0.6F);
        const Vec3 more = further_bounces(Vec3(0.5F), t.full_mean.at(0.6F));
        const double exact = static_cast<double>(0.5F * (full - edge) + edge + more.y * (1 - full));
        CHECK(furnace(point, direction(cosine)) == doctest::Approx(exact).epsilon(0.005).scale(0));
    }
}

TEST_CASE("furnace: rough glass passes on all light") {
    for (const float roughness : {0.05F, 0.2F, 0.5F, 0.8F, 1.0F}) {
        for (const float cosine : {1.0F, 0.6F, 0.2F}) {
            for (const bool solid : {true, false}) {
                CAPTURE(roughness);
                CAPTURE(cosine);
                CAPTURE(solid);
                CHECK(std::abs(furnace(glass(roughness, solid), direction(cosine)) - 1) < 0.02);
            }
            CHECK(std::abs(furnace(glass(roughness, true, true), direction(cosine)) - 1) < 0.02);
        }
    }
}

TEST_CASE("opaque materials are reciprocal") {
    Random random(3);
    for (int i = 0; i < 2000; ++i) {
        MaterialPoint point = white(random.uniform(0.05F, 1), random.uniform());
        point.base_colour = {random.uniform(), random.uniform(), random.uniform()};
        const Vec3 a = direction(random.uniform(0.05F, 1), random.uniform(0, 6));
        const Vec3 b = direction(random.uniform(0.05F, 1), random.uniform(0, 6));
        const Vec3 there = Standard(point, a).evaluate(b) / b.z;
        const Vec3 back = Standard(point, b).evaluate(a) / a.z;
        for (int c = 0; c < 3; ++c)
            CHECK(there[c] == doctest::Approx(back[c]).epsilon(1e-3).scale(0));
    }
}

TEST_CASE("bumps take light from near the horizon of the surface away from the diffuse base") {
    MaterialPoint flat = white(1, 0), bumpy = flat;
    flat.ior = bumpy.ior = 1;
    bumpy.smooth = direction(0.8F, 0);
    const Vec3 seen = direction(0.9F);
    const auto share = [&](const Vec3& incoming) {
        return Standard(bumpy, seen).evaluate(incoming).x /
               Standard(flat, seen).evaluate(incoming).x;
    };
    // Towards the side that the bump leans away from, the horizon comes first; straight to it none
    // is lost.
    CHECK(share(bumpy.smooth) == doctest::Approx(1));
    CHECK(share(direction(0.9F, 0)) == doctest::Approx(1));
    const float tilt = std::acos(0.8F);
    const auto below = [&](float angle) {
        return Vec3(-std::sin(angle - tilt), 0, std::cos(angle - tilt));
    };
    float last = 1;
    for (const float angle : {0.9F, 1.1F, 1.3F, 1.5F}) {
        const Vec3 incoming = below(angle);
        CAPTURE(angle);
        const float g = std::cos(angle) / (incoming.z * 0.8F);
        CHECK(share(incoming) == doctest::Approx(g + g * g - g * g * g).epsilon(5e-3).scale(0));
        CHECK(share(incoming) < last);
        last = share(incoming);
    }
    CHECK(share(below(1.6F)) < 0.01F);  // the varnish's part
}

TEST_CASE("directions are drawn with the density that a material states") {
    const Vec3 outgoing = direction(0.7F);
    for (const float roughness : {0.25F, 0.5F, 1.0F}) {
        for (const float metallic : {0.0F, 1.0F}) {
            CAPTURE(roughness);
            CAPTURE(metallic);
            const MaterialPoint point = white(roughness, metallic);
            CHECK(std::abs(deviation(point, point, outgoing)) < 5);
        }
        CAPTURE(roughness);
        for (const bool inside : {false, true}) {
            const MaterialPoint solid = glass(roughness, true, inside);
            CHECK(std::abs(deviation(solid, solid, outgoing)) < 5);
        }
        const MaterialPoint sheet = glass(roughness, false);
        CHECK(std::abs(deviation(sheet, sheet, outgoing)) < 5);
    }
}

TEST_CASE("a roughness that is 5 % off does not pass for the stated one") {
    const Vec3 outgoing = direction(0.7F);
    for (const float roughness : {0.25F, 0.5F, 0.9F}) {
        CAPTURE(roughness);
        CHECK(deviation(white(roughness * 1.05F, 1), white(roughness, 1), outgoing) > 20);
        CHECK(deviation(white(roughness * 1.05F, 0), white(roughness, 0), outgoing) > 10);
        CHECK(deviation(glass(roughness * 1.05F, true), glass(roughness, true), outgoing) > 10);
    }
}

TEST_CASE("without layers, `layered` is `standard`") {
    Random random(5);
    for (int i = 0; i < 300; ++i) {
        MaterialPoint point = white(random.uniform(0.05F, 1), random.uniform());
        point.base_colour = {random.uniform(), random.uniform(), random.uniform()};
        point.transmission = i % 3 == 0 ? random.uniform() : 0.0F;
        const Vec3 a = direction(random.uniform(0.05F, 1), random.uniform(0, 6));
        const Vec3 b = direction(random.uniform(0.05F, 1), random.uniform(0, 6));
        const Scattered plain = Standard(point, a).scatter(b);
        const Scattered layered = Layered(point, a).scatter(b);
        CHECK(layered.density == doctest::Approx(plain.density).epsilon(1e-4).scale(0));
        for (int c = 0; c < 3; ++c)
            CHECK(layered.value[c] == doctest::Approx(plain.value[c]).epsilon(1e-4).scale(0));
    }
}

TEST_CASE("white furnace: a coat over a white base loses no light, and no layer makes any") {
    for (const float cosine : {1.0F, 0.8F, 0.5F, 0.25F, 0.1F}) {
        CAPTURE(cosine);
        const Vec3 seen = direction(cosine);
        for (const float roughness : {0.03F, 0.3F, 0.8F}) {
            CAPTURE(roughness);
            MaterialPoint chalk = coated(1, 0, roughness);
            chalk.ior = 1;
            CHECK(std::abs(furnace<Layered>(chalk, seen) - 1) < 0.005);
            CHECK(std::abs(furnace<Layered>(coated(0.03F, 1, 0.03F), seen) - 1) < 0.005);
            // Light that goes back and forth between two glossy lobes is lost.
            const double metal = furnace<Layered>(coated(0.5F, 1, roughness), seen);
            CHECK(metal < 1.005);
            CHECK(metal > 0.85);
            const double sheen = furnace<Layered>(cloth(roughness), seen);
            CHECK(sheen < 1.02);
            CHECK(sheen > 0.75);
            MaterialPoint half = white(roughness, 0);
            half.layers.specular = 0.5F;
            half.layers.specular_colour = {1, 3, 1};
            CHECK(std::abs(furnace<Layered>(half, seen) - 1) < 0.005);
            for (const float strength : {0.3F, 0.9F}) {
                const double metal_brushed =
                    furnace<Layered>(brushed(roughness, 1, strength), seen);
                CHECK(metal_brushed < 1.08);
                CHECK(metal_brushed > 0.92);
            }
        }
        CHECK(furnace<Layered>(all_layers(), seen) < 1);
    }
}

TEST_CASE("layers are reciprocal") {
    Random random(3);
    for (int i = 0; i < 2000; ++i) {
        MaterialPoint point = all_layers();
        point.roughness = random.uniform(0.05F, 1);
        point.layers.clearcoat = random.uniform();
        const Vec3 a = direction(random.uniform(0.35F, 1), random.uniform(0, 6));
        const Vec3 b = direction(random.uniform(0.35F, 1), random.uniform(0, 6));
        point.coat_normal = {0, 0, 1};
        const Vec3 there = Layered(point, a).evaluate(b) / b.z;
        const Vec3 back = Layered(point, b).evaluate(a) / a.z;
        for (int c = 0; c < 3; ++c)
            CHECK(there[c] == doctest::Approx(back[c]).epsilon(1e-3).scale(0));
    }
}

TEST_CASE("directions of layers are drawn with the density that they state") {
    const Vec3 outgoing = direction(0.7F);
    for (const MaterialPoint& point :
         {coated(1, 0, 0.4F), coated(0.5F, 1, 0.25F), cloth(0.5F), brushed(0.4F, 1, 0.5F),
          brushed(0.5F, 0, 0.9F), all_layers()})
        CHECK(std::abs(deviation<Layered>(point, point, outgoing)) < 5);
    CHECK(deviation<Layered>(brushed(0.4F, 1, 0.55F), brushed(0.4F, 1, 0.5F), outgoing) > 10);
    MaterialPoint turned = brushed(0.4F, 1, 0.5F);
    turned.along = {std::cos(0.6F), std::sin(0.6F)};
    CHECK(deviation<Layered>(turned, brushed(0.4F, 1, 0.5F), outgoing) > 10);
}

TEST_CASE("sheen, brushed metal and thin films are those of glTF's extensions") {
    // By the extensions' own formulas, in double.
    const struct {
        float roughness, seen, lit;
        double value;
    } fibres[] = {
        {0.3F, 0.7F, 0.4F, 0.000144629508597184}, {0.3F, 0.15F, 0.3F, 0.05442585016042909},
        {0.5F, 0.2F, 0.9F, 0.021322573286969276}, {0.5F, 0.15F, 0.3F, 0.08785716145466023},
        {1.0F, 0.7F, 0.4F, 0.03864147022563119},  {1.0F, 0.2F, 0.9F, 0.09072161441342183}};
    for (const auto& [roughness, seen, lit, value] : fibres) {
        const SheenLobe lobe(seen, roughness);
        CHECK(static_cast<double>(lobe.evaluate(direction(seen), direction(lit, 3))) ==
              doctest::Approx(value).epsilon(2e-3).scale(0));
    }
    const MaterialPoint metal = brushed(0.3F, 1, 0.64F);
    const auto lobe = [&](float seen) {
        return AnisotropicLobe::of(metal, direction(seen), 0.3F, Vec3(1), 1);
    };
    CHECK(lobe(0.7F).scatter(direction(0.4F, 3)).value.x ==
          doctest::Approx(0.00178174817563496).epsilon(1e-3).scale(0));
    CHECK(lobe(0.2F).scatter(direction(0.9F, 3)).value.x ==
          doctest::Approx(0.021733526851285573).epsilon(1e-3).scale(0));
    const struct {
        float ior, cosine, thickness;
        Vec3 below, value;
    } films[] = {{1.3F, 1, 400, Vec3(0.04F), {0.00745647F, 0.03835172F, 0.01603821F}},
                 {1.3F, 0.6F, 250, Vec3(0.04F), {0.03300006F, 0.04426075F, 0.03529373F}},
                 {1.8F, 0.9F, 550, {1, 0.8F, 0.3F}, {0.99987549F, 0.6016725F, 0.17451851F}},
                 {1.3F, 0.2F, 400, Vec3(0.5F), {0.94722619F, 0.41004325F, 0}}};
    for (const auto& [ior, cosine, thickness, below, value] : films)
        CHECK(glm::length(iridescent_f0(cosine, ior, thickness, below) - value) < 2e-4F);
    // No film, no change.
    CHECK(glm::length(iridescent_f0(1, 1.3F, 0, Vec3(0.3F)) - Vec3(0.3F)) < 0.01F);
}

TEST_CASE("kinds of materials resolve by name, and an unknown kind is glTF's material") {
    CHECK(material_kind("standard") == default_material());
    CHECK(material_kind("unlit"));
    CHECK_FALSE(material_kind("velvet"));
    MaterialPoint point;
    point.base_colour = {0.1F, 0.2F, 0.3F};
    const auto emitted = [&](std::uint32_t kind) {
        return with_material(kind, point, Vec3(0, 0, 1),
                             [](const auto& material) { return material.emitted(); });
    };
    CHECK(emitted(*material_kind("unlit")) == point.base_colour);
    CHECK(emitted(0) == Vec3(0));
    CHECK(emitted(12345) == Vec3(0));
}
