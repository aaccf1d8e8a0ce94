// Opacity against sampling: no point of a triangle may have an alpha that its two bytes exclude,
// and no answer may change when they are taken away.
#include "engine/assets/builtin/builtin.h"
#include "engine/intersectors/texture.h"
#include "engine/packs/registry.h"
#include "engine/scene/format.h"
#include "engine/scene/snapshot.h"
#include "tests/conformance/answers.h"
#include "tests/conformance/scenes.h"
#include "tests/sanitized.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <utility>
#include <vector>

using namespace raynest;
using conformance::Random;

namespace {

/// Patches of equal alpha, so that some triangles see one value and some see several.
ImageDescription patches(Random& random) {
    ImageDescription image{1 + random.below(40), 1 + random.below(40), {}};
    image.rgba.assign(std::size_t{4} * image.width * image.height, 255);
    const std::uint32_t side = 1 + random.below(12);
    for (std::uint32_t y = 0; y < image.height; ++y) {
        for (std::uint32_t x = 0; x < image.width; ++x) {
            Random patch(x / side * 64 + y / side);
            static_cast<void>(patch.bits());
            const std::uint32_t kind = patch.below(4);
            image.rgba[4 * (std::size_t{y} * image.width + x) + 3] =
                static_cast<std::uint8_t>(kind == 0   ? 0
                                          : kind == 1 ? 255
                                          : kind == 2 ? patch.below(256)
                                                      : random.below(256));
        }
    }
    return image;
}

/// One mesh of loose triangles, everything that alpha depends on drawn by lot.
SceneDescription masked_scene(Random& random) {
    SceneDescription scene;
    scene.images.push_back(patches(random));
    const auto wrap = [&] { return static_cast<Wrap>(random.below(3)); };
    scene.textures.push_back({0, wrap(), wrap(), random.below(2) == 0});
    MaterialDescription& material = scene.materials.emplace_back();
    material.alpha_mode = random.below(2) == 0 ? AlphaMode::mask : AlphaMode::blend;
    material.texture = random.below(16) == 0 ? no_id : 0;
    constexpr float factors[] = {1, 1, 0.5F, 1.5F, 0, -1, 0.997F};
    material.base_colour.w = factors[random.below(7)];
    if (random.below(2) == 0) {
        for (float& m : material.uv_transform) m = random.between(-2, 2);
    }

    GeometryDescription geometry;
    geometry.material = 0;
    const float reach = std::pow(10.0F, random.between(-2, 1));
    const float offset = random.below(8) == 0 ? 3000.0F : 2.0F;
    const Vec2 at(random.between(-offset, offset), random.between(-offset, offset));
    const bool has_texcoords = random.below(8) != 0;
    const bool has_colours = random.below(3) == 0;
    for (std::uint32_t i = 0; i < 3 * 12; ++i) {
        geometry.indices.push_back(i);
        geometry.positions.push_back(random.in_box(1));
        if (has_texcoords) {
            geometry.texcoords[0].push_back(
                at + Vec2(random.between(-reach, reach), random.between(-reach, reach)));
            constexpr float odd[] = {std::numeric_limits<float>::quiet_NaN(),
                                     std::numeric_limits<float>::infinity(), 1e30F, -3e38F};
            if (random.below(60) == 0) geometry.texcoords[0].back().x = odd[random.below(4)];
        }
        for (int k = 0; k < 4 && has_colours; ++k) {
            geometry.colours.push_back(static_cast<std::uint8_t>(128 + random.below(128)));
        }
    }
    scene.objects.emplace_back().geometries.push_back(std::move(geometry));
    return scene;
}

/// Corners, edges and the inside.
Vec2 barycentric(std::uint32_t i, Random& random) {
    if (i < 3) return {i == 1 ? 1.0F : 0.0F, i == 2 ? 1.0F : 0.0F};
    const float u = random.unit();
    if (i % 8 == 0) return {u, 0};
    if (i % 8 == 1) return {0, u};
    if (i % 8 == 2) return {u, 1 - u};
    return {u, random.unit() * (1 - u)};
}

std::shared_ptr<const Snapshot> built(const SceneDescription& scene) {
    const auto snapshot = Snapshot::build(scene);
    REQUIRE(snapshot.has_value());
    return *snapshot;
}

/// The same scene, knowing nothing of any triangle's opacity.
std::shared_ptr<const Snapshot> without_opacity(const Snapshot& scene) {
    Arena arena(scene.bytes().size());
    std::copy(scene.bytes().begin(), scene.bytes().end(), arena.data());
    const auto* first = format::section<GeometryRecord>(arena.data(), format::Section::geometries);
    for (std::uint32_t i = 0; i < scene.view().geometry_count; ++i) {
        const_cast<GeometryRecord&>(first[i]).opacity = no_offset;
    }
    const auto snapshot = Snapshot::open({std::move(arena)});
    REQUIRE(snapshot.has_value());
    return *snapshot;
}

}  // namespace

TEST_CASE("no point of a triangle has an alpha that its opacity excludes") {
    Random random(31);
    std::uint64_t wrong = 0, decided = 0, triangles = 0;
    for (int round = 0; round < 600; ++round) {
        const auto scene = built(masked_scene(random));
        const SceneView& view = scene->view();
        const GeometryRecord& geometry = view.geometries[0];
        for (std::uint32_t t = 0; t < geometry.triangle_count; ++t) {
            const Opacity opacity = view.opacity_of(geometry, t);
            for (std::uint32_t i = 0; i < 400; ++i) {
                const Vec2 uv = barycentric(i, random);
                const float alpha = surface_alpha(view, geometry, view.materials[0], t, uv.x, uv.y);
                // The cutoffs that this very point decides.
                const float above = std::nextafter(alpha, std::numeric_limits<float>::infinity());
                if (opacity.is_all_at_least(above) || opacity.is_all_below(alpha)) ++wrong;
            }
            ++triangles;
            if (opacity.is_all_at_least(0.5F) || opacity.is_all_below(0.5F)) ++decided;
        }
    }
    CHECK(wrong == 0);
    CHECK(decided > triangles / 5);
}

TEST_CASE("opacity looks at the texels under the triangle and at no others") {
    // Nearest texels: dense sampling meets each that the triangle covers more than a little of.
    Random random(32);
    std::uint64_t wider = 0, triangles = 0;
    for (int round = 0; round < 40; ++round) {
        SceneDescription description = masked_scene(random);
        description.textures[0].nearest = true;
        description.materials[0].texture = 0;
        description.materials[0].base_colour.w = 1;
        description.objects[0].geometries[0].colours.clear();
        const auto scene = built(description);
        const SceneView& view = scene->view();
        const GeometryRecord& geometry = view.geometries[0];
        for (std::uint32_t t = 0; t < geometry.triangle_count; ++t) {
            float least = 1, largest = 0;
            for (std::uint32_t i = 0; i < 4000; ++i) {
                const Vec2 uv = barycentric(i, random);
                const float alpha = surface_alpha(view, geometry, view.materials[0], t, uv.x, uv.y);
                least = std::min(least, alpha);
                largest = std::max(largest, alpha);
            }
            const Opacity opacity = view.opacity_of(geometry, t);
            ++triangles;
            if (static_cast<float>(opacity.least) < 255 * least - 1.5F ||
                static_cast<float>(opacity.largest) > 255 * largest + 1.5F) {
                ++wider;
            }
        }
    }
    CHECK(triangles > 400);
    CHECK(wider < triangles / 4);
}

TEST_CASE("opacity of one alpha everywhere is that alpha, rounded outward") {
    Random random(33);
    for (const auto& [alpha, least, largest] :
         {std::tuple{0, 0, 0}, std::tuple{100, 99, 101}, std::tuple{255, 254, 255}}) {
        SceneDescription description = masked_scene(random);
        description.materials[0] = {};
        description.materials[0].alpha_mode = AlphaMode::mask;
        description.materials[0].texture = 0;
        description.objects[0].geometries[0].colours.clear();
        for (std::size_t i = 3; i < description.images[0].rgba.size(); i += 4) {
            description.images[0].rgba[i] = static_cast<std::uint8_t>(alpha);
        }
        const auto scene = built(description);
        const Opacity opacity = scene->view().opacity_of(scene->view().geometries[0], 5);
        CHECK(int{opacity.least} == least);
        CHECK(int{opacity.largest} == largest);
    }
}

TEST_CASE("no answer changes when the opacity of all triangles is ignored") {
    const auto registry = Registry::load({});
    REQUIRE(registry.has_value());
    const Variant& variant = *(*registry)->find("alpha_mask");
    Random random(34);
    const auto forest = describe_builtin("builtin:forest?trees=20&leaves=200");
    REQUIRE(forest.has_value());
    for (const SceneDescription& description : {*forest, conformance::nested_scene(3, 2)}) {
        const auto scene = built(description);
        const auto plain = without_opacity(*scene);
        const Box& box = scene->bounds();
        auto rays = conformance::random_rays(test::sanitized_share(30'000U, 10U), 8, random);
        for (std::size_t i = 0; i < rays.size(); i += 2) {
            for (int axis = 0; axis < 3; ++axis) {
                rays[i].origin[axis] = random.between(box.lower[axis], box.upper[axis]);
            }
        }
        for (const std::string cutoff : {"", "0", "0.01", "0.3", "0.9", "1"}) {
            std::vector<std::pair<std::string, std::string>> assignments;
            if (!cutoff.empty()) assignments.emplace_back("cutoff", cutoff);
            const auto settings = parse_settings(variant, assignments);
            REQUIRE(settings.has_value());
            for (const conformance::Question& question : conformance::questions) {
                for (std::uint32_t t = 0; t < traversal_reference; ++t) {
                    const auto function =
                        find_function(variant, question.query, static_cast<Traversal>(t));
                    if (!function) continue;
                    CAPTURE(cutoff);
                    CAPTURE(question.query);
                    CAPTURE(t);
                    const auto answer = [&](const Snapshot& snapshot) {
                        return conformance::ask(variant, *function, snapshot.view(), rays, question,
                                                *settings);
                    };
                    const conformance::Answer with = answer(*scene);
                    CHECK(conformance::differing_rays(with, answer(*plain)).rays == 0);
                    CHECK(std::any_of(with.hits.begin(), with.hits.end(),
                                      [](const HitRecord& hit) { return hit.hit != 0; }));
                }
            }
        }
    }
}
