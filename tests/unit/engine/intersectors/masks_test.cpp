// Tests which hits alpha_mask and procedural_mask keep, through the packs as in a request.
#include "engine/packs/registry.h"
#include "engine/scene/snapshot.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>
#include <vector>

using namespace raynest;

namespace {

// A unit quad in the plane z = 0 facing +z with texture coordinates equal to x and 1 - y.
SceneDescription quad(MaterialDescription material, ImageDescription image, bool nearest,
                      Wrap wrap = Wrap::repeat) {
    SceneDescription scene;
    GeometryDescription g;
    g.positions = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}};
    g.texcoords[0] = {{0, 1}, {1, 1}, {1, 0}, {0, 0}};
    g.indices = {0, 1, 2, 0, 2, 3};
    g.material = 0;
    material.texture = 0;
    scene.images.push_back(std::move(image));
    scene.textures.push_back({0, wrap, wrap, nearest});
    scene.materials.push_back(std::move(material));
    scene.objects.emplace_back().geometries.push_back(std::move(g));
    return scene;
}

// Returns 2 x 2 texels, alpha row by row from the top.
ImageDescription alphas(std::uint8_t a, std::uint8_t b, std::uint8_t c, std::uint8_t d) {
    return {2, 2, {255, 255, 255, a, 255, 255, 255, b, 255, 255, 255, c, 255, 255, 255, d}};
}

MaterialDescription material(AlphaMode mode, float cutoff = 0.5F, float factor = 1) {
    MaterialDescription m;
    m.alpha_mode = mode;
    m.cutoff = cutoff;
    m.base_colour.w = factor;
    return m;
}

using Assignments = std::vector<std::pair<std::string, std::string>>;

bool is_hit(const SceneDescription& description, float x, float y, const char* intersector,
            const Assignments& settings = {}, float direction = -1) {
    static const auto registry = Registry::load({});
    REQUIRE_MESSAGE(registry.has_value(), (registry ? "" : registry.error().message));
    const auto scene = Snapshot::build(description);
    REQUIRE(scene.has_value());
    const auto variant = (*registry)->choose(intersector, (*scene)->view());
    REQUIRE(variant.has_value());
    const auto parsed = parse_settings(**variant, settings);
    REQUIRE_MESSAGE(parsed.has_value(), (parsed ? "" : parsed.error().message));
    const auto function = find_function(**variant, query_closest, traversal_single);
    Ray ray;
    ray.origin = {x, y, -direction};
    ray.direction = {0, 0, direction};
    HitRecord hit;
    const TraceCall call{&(*scene)->view(),
                         parsed->params.data(),
                         &ray,
                         1,
                         1,
                         0xFFFFFFFFU,
                         parsed->flags,
                         &hit,
                         nullptr,
                         nullptr,
                         nullptr};
    REQUIRE((*function)(&call) == trace_ok);
    return hit.hit != 0;
}

}  // namespace

TEST_CASE("alpha_mask keeps MASK texels at or above the material's cutoff") {
    const auto scene = quad(material(AlphaMode::mask), alphas(255, 0, 0, 128), true);
    CHECK(is_hit(scene, 0.2F, 0.8F, "alpha_mask"));
    CHECK_FALSE(is_hit(scene, 0.8F, 0.8F, "alpha_mask"));
    CHECK_FALSE(is_hit(scene, 0.2F, 0.2F, "alpha_mask"));
    CHECK(is_hit(scene, 0.8F, 0.2F, "alpha_mask"));  // 128/255 >= 0.5
    CHECK(is_hit(scene, 0.8F, 0.8F, "opaque"));
}

TEST_CASE("alpha that equals the cutoff is hit, beside other texels and everywhere") {
    for (const std::uint8_t beside : {std::uint8_t{0}, std::uint8_t{255}}) {
        CAPTURE(int{beside});
        for (const AlphaMode mode : {AlphaMode::mask, AlphaMode::blend}) {
            const auto scene =
                quad(material(mode, 0.5F, 0.5F), alphas(255, 0, beside, beside), true);
            CHECK(is_hit(scene, 0.2F, 0.8F, "alpha_mask"));
            CHECK_FALSE(is_hit(scene, 0.8F, 0.8F, "alpha_mask"));
        }
        const auto above = quad(material(AlphaMode::mask, std::nextafter(0.5F, 1.0F), 0.5F),
                                alphas(255, 0, beside, beside), true);
        CHECK_FALSE(is_hit(above, 0.2F, 0.8F, "alpha_mask"));
    }
}

TEST_CASE("--set cutoff overrides MASK materials only") {
    const auto mask = quad(material(AlphaMode::mask, 0.9F), alphas(100, 100, 100, 100), false);
    CHECK_FALSE(is_hit(mask, 0.5F, 0.5F, "alpha_mask"));
    CHECK(is_hit(mask, 0.5F, 0.5F, "alpha_mask", {{"cutoff", "0.01"}}));
    const auto blend = quad(material(AlphaMode::blend, 0.9F), alphas(100, 100, 100, 100), false);
    CHECK_FALSE(is_hit(blend, 0.5F, 0.5F, "alpha_mask", {{"cutoff", "0.01"}}));
    const auto opaque = quad(material(AlphaMode::opaque), alphas(0, 0, 0, 0), false);
    CHECK(is_hit(opaque, 0.5F, 0.5F, "alpha_mask", {{"cutoff", "1"}}));
}

TEST_CASE("alpha is factor x texture, bilinear between texel centres, nearest on request") {
    // Between a texel of 255 and one of 0 the bilinear alpha is 0.5 in the middle.
    const auto soft = quad(material(AlphaMode::mask), alphas(255, 0, 255, 0), false, Wrap::clamp);
    CHECK(is_hit(soft, 0.45F, 0.5F, "alpha_mask"));
    CHECK_FALSE(is_hit(soft, 0.55F, 0.5F, "alpha_mask"));
    const auto dim =
        quad(material(AlphaMode::mask, 0.5F, 0.6F), alphas(255, 0, 255, 0), false, Wrap::clamp);
    CHECK(is_hit(dim, 0.2F, 0.5F, "alpha_mask"));
    CHECK_FALSE(is_hit(dim, 0.4F, 0.5F, "alpha_mask"));
    // Repeating blends across the border, clamping does not.
    const auto repeat = quad(material(AlphaMode::mask, 0.6F), alphas(255, 0, 255, 0), false);
    CHECK_FALSE(is_hit(repeat, 0.01F, 0.5F, "alpha_mask"));
    const auto clamp =
        quad(material(AlphaMode::mask, 0.6F), alphas(255, 0, 255, 0), false, Wrap::clamp);
    CHECK(is_hit(clamp, 0.01F, 0.5F, "alpha_mask"));
}

TEST_CASE("the texture transform moves the mask") {
    auto moved = material(AlphaMode::mask);
    moved.uv_transform = {1, 0, 0.5F, 0, 1, 0};
    const auto scene = quad(moved, alphas(255, 0, 255, 0), true);
    CHECK_FALSE(is_hit(scene, 0.2F, 0.5F, "alpha_mask"));
    CHECK(is_hit(scene, 0.8F, 0.5F, "alpha_mask"));
}

TEST_CASE("auto is alpha_mask where a material is masked, else opaque") {
    const auto mask = quad(material(AlphaMode::mask), alphas(0, 0, 0, 0), false);
    CHECK_FALSE(is_hit(mask, 0.5F, 0.5F, "auto"));
    const auto opaque = quad(material(AlphaMode::opaque), alphas(0, 0, 0, 0), false);
    CHECK(is_hit(opaque, 0.5F, 0.5F, "auto"));
}

TEST_CASE("cull=back drops back faces of single-sided materials only") {
    auto one = material(AlphaMode::opaque);
    const auto single = quad(one, alphas(255, 255, 255, 255), false);
    const Assignments cull{{"cull", "back"}};
    CHECK(is_hit(single, 0.5F, 0.5F, "opaque", cull, -1));
    CHECK(is_hit(single, 0.5F, 0.5F, "opaque", {}, 1));
    CHECK_FALSE(is_hit(single, 0.5F, 0.5F, "opaque", cull, 1));
    one.double_sided = true;
    const auto both = quad(one, alphas(255, 255, 255, 255), false);
    CHECK(is_hit(both, 0.5F, 0.5F, "opaque", cull, 1));
}

TEST_CASE("procedural_mask cuts its pattern into masked materials, or all of them") {
    const auto mask = quad(material(AlphaMode::mask), alphas(255, 255, 255, 255), false);
    const Assignments discs{{"pattern", "discs"}, {"scale", "1"}, {"fill", "0.5"}};
    CHECK(is_hit(mask, 0.5F, 0.5F, "procedural_mask", discs));
    CHECK_FALSE(is_hit(mask, 0.05F, 0.05F, "procedural_mask", discs));
    const Assignments heart{{"pattern", "heart"}, {"scale", "1"}};
    CHECK(is_hit(mask, 0.5F, 0.5F, "procedural_mask", heart));
    CHECK_FALSE(is_hit(mask, 0.05F, 0.05F, "procedural_mask", heart));
    CHECK(is_hit(mask, 0.3F, 0.3F, "procedural_mask", {{"pattern", "noise"}, {"fill", "1"}}));
    CHECK_FALSE(is_hit(mask, 0.3F, 0.3F, "procedural_mask", {{"pattern", "noise"}, {"fill", "0"}}));

    // Beside a masked material an opaque one is not cut, unless on=all.
    auto mixed = quad(material(AlphaMode::opaque), alphas(255, 255, 255, 255), false);
    mixed.materials.push_back(material(AlphaMode::mask));
    CHECK(is_hit(mixed, 0.05F, 0.05F, "procedural_mask", discs));
    Assignments everywhere = discs;
    everywhere.emplace_back("on", "all");
    CHECK_FALSE(is_hit(mixed, 0.05F, 0.05F, "procedural_mask", everywhere));
}

TEST_CASE("infinite coordinates of a pattern count as its first cell") {
    auto far = quad(material(AlphaMode::mask), alphas(255, 255, 255, 255), false);
    auto first = far;
    std::fill_n(far.objects[0].geometries[0].texcoords[0].begin(), 4, Vec2(3e38F, -3e38F));
    std::fill_n(first.objects[0].geometries[0].texcoords[0].begin(), 4, Vec2(0, 0));
    for (int seed = 0; seed < 8; ++seed) {
        const Assignments noise{{"pattern", "noise"},
                                {"scale", "1000000"},
                                {"fill", "0.5"},
                                {"seed", std::to_string(seed)}};
        CHECK(is_hit(far, 0.3F, 0.3F, "procedural_mask", noise) ==
              is_hit(first, 0.3F, 0.3F, "procedural_mask", noise));
    }
}

TEST_CASE("a texture without its texture coordinates counts 1") {
    auto description = quad(material(AlphaMode::mask), alphas(0, 255, 255, 0), true);
    CHECK_FALSE(is_hit(description, 0.2F, 0.8F, "alpha_mask"));
    description.objects[0].geometries[0].texcoords[0].clear();
    for (const float x : {0.2F, 0.8F})
        for (const float y : {0.2F, 0.8F}) CHECK(is_hit(description, x, y, "alpha_mask"));
    description.materials[0].base_colour.w = 0.4F;
    CHECK_FALSE(is_hit(description, 0.8F, 0.8F, "alpha_mask"));
}
