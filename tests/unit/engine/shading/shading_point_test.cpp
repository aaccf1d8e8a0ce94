// What shading sees of a hit: normals of normal textures, and colours of vertices.
#include "engine/shading/shading_point.h"

#include "engine/scene/texture_levels.h"
#include "engine/shading/placement.h"
#include "engine/shading/types.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <cmath>

using namespace raynest;

namespace {

/// A square that faces +z, in the middle of which one texel gives the normal.
SceneDescription bumpy_square(bool has_tangents, const Transform& placement,
                              ImageDescription image = {1, 1, {127, 77, 207, 255}}) {
    SceneDescription scene;
    scene.images.push_back(std::move(image));
    scene.textures.push_back({0});
    scene.textures[0].linear = true;
    scene.materials.resize(1);
    scene.materials[0].surface.use(TextureSlot::normal).texture = 0;
    scene.objects.resize(2);
    GeometryDescription square = test::unit_square(0);
    // v runs down the picture.
    for (Vec2& st : square.texcoords[0]) st.y = 1 - st.y;
    square.normals.assign(4, {0, 0, 1});
    if (has_tangents) square.tangents.assign(4, {1, 0, 0, 1});
    scene.objects[0].geometries = {square};
    scene.objects[1].instances = {test::place(0, placement)};
    scene.root = 1;
    return scene;
}

/// Places the scene's root once more.
SceneDescription nested(SceneDescription scene, const Transform& placement) {
    scene.objects.emplace_back().instances = {test::place(scene.root, placement)};
    scene.root = static_cast<std::uint32_t>(scene.objects.size() - 1);
    return scene;
}

/// Shades the middle of the first triangle, seen along a direction in the world by a cone of this
/// width.
ShadingPoint seen(const SceneDescription& description, const Vec3& direction = {0, 0, -1},
                  float width = 1e-3F) {
    const auto scene = test::build_scene(description);
    HitRecord hit;
    hit.hit = 1;
    hit.triangle = hit.object = 0;
    hit.path = 0;
    hit.u = hit.v = 1.0F / 3;
    Placement placement;
    placement.set(scene->view(), 0);
    Ray ray;
    ray.direction = direction;
    const Vec3 normal(glm::normalize(placement.normal({0, 0, 1})));
    const TextureTable table(scene->shading());
    TextureBatch batch(table);
    UnfinishedPoint point;
    begin_point(scene->shading(), ray, hit, normal, 1, width, placement, batch, point);
    batch.run();
    ShadingPoint shaded = finish_point(point);
    shaded.surface = nullptr;  // it goes with the scene
    return shaded;
}

Vec3 normal_of(const SceneDescription& description) {
    return seen(description).frame.z;
}

}  // namespace

TEST_CASE(
    "a placement that mirrors mirrors what a normal texture shows, with tangents or without") {
    const Transform plain{}, mirror = test::scaling(-1, 1, 1), high = test::scaling(1, 1, -1);
    for (const bool has_tangents : {false, true}) {
        CAPTURE(has_tangents);
        const Vec3 n = normal_of(bumpy_square(has_tangents, plain));
        CHECK(n.x == doctest::Approx(0).epsilon(0.01));
        CHECK(n.y == doctest::Approx(-0.54).epsilon(0.02).scale(0));
        const auto check = [&](const SceneDescription& scene, const Vec3& expected) {
            CHECK(glm::length(normal_of(scene) - expected) < 1e-5F);
        };
        const Vec3 across(-n.x, n.y, n.z);
        check(bumpy_square(has_tangents, mirror), across);
        check(nested(bumpy_square(has_tangents, mirror), plain), across);
        check(nested(bumpy_square(has_tangents, plain), mirror), across);
        check(nested(bumpy_square(has_tangents, mirror), mirror), n);
        // The square's back, with the bumps where they were.
        const ShadingPoint back = seen(bumpy_square(has_tangents, high));
        CHECK_FALSE(back.front);
        CHECK(glm::length(back.frame.z - Vec3(-n.x, -n.y, n.z)) < 1e-5F);
    }
}

TEST_CASE(
    "bumps that lean away from a grazing view bend until the mirrored view leaves the surface") {
    const SceneDescription bumpy = bumpy_square(true, Transform{});
    for (int azimuth = 0; azimuth < 360; azimuth += 15) {
        for (const float height : {0.02F, 0.1F, 0.3F, 0.6F}) {
            CAPTURE(azimuth);
            CAPTURE(height);
            const float angle = static_cast<float>(azimuth) * 0.0174533F;
            const Vec3 viewer = glm::normalize(Vec3(std::cos(angle), std::sin(angle), height));
            const Vec3 n = seen(bumpy, -viewer).frame.z;
            CHECK(glm::length(n) == doctest::Approx(1).epsilon(1e-4));
            CHECK(glm::dot(n, viewer) > 0);
            CHECK((2.0F * glm::dot(n, viewer) * n - viewer).z > 0);
        }
    }
}

TEST_CASE("the scale of a normal texture lowers its bumps") {
    SceneDescription bumpy = bumpy_square(true, Transform{});
    const Vec3 n = normal_of(bumpy);
    bumpy.materials[0].surface.normal_scale = 0.5F;
    const Vec3 half = normal_of(bumpy);
    CHECK(half.y / half.z ==
          doctest::Approx(0.5 * static_cast<double>(n.y / n.z)).epsilon(1e-4).scale(0));
}

TEST_CASE("an emission texture is decoded from sRGB, for the surface and for its light") {
    SceneDescription glowing = bumpy_square(false, Transform{}, {1, 1, {188, 188, 188, 255}});
    SurfaceRecord& surface = glowing.materials[0].surface;
    surface.use(TextureSlot::normal).texture = no_id;
    surface.use(TextureSlot::emission).texture = 0;
    surface.emission = Vec3(2);
    glowing.textures[0].linear = false;
    CHECK(seen(glowing).material.emission.y == doctest::Approx(2 * 0.503).epsilon(0.005));
    const auto scene = test::build_scene(glowing);
    CHECK(triangle_emission(scene->shading(), scene->view().objects[0], 0, 0.3F, 0.3F).y ==
          doctest::Approx(2 * 0.503).epsilon(0.005));
}

TEST_CASE("a wide cone does not flatten bumps") {
    // Every texel leans, half of them to either side.
    ImageDescription image{16, 16, {}};
    for (unsigned texel = 0; texel < 256; ++texel)
        for (const unsigned value : {127U, texel % 16 < 8 ? 47U : 207U, 207U, 255U})
            image.rgba.push_back(static_cast<std::uint8_t>(value));
    const SceneDescription bumpy = bumpy_square(true, Transform{}, image);
    const Vec3 fine = seen(bumpy).frame.z;
    CHECK(std::abs(fine.y) > 0.5F);
    CHECK(glm::length(seen(bumpy, {0, 0, -1}, 10).frame.z - fine) < 1e-6F);
}

TEST_CASE("a material knows the normal below its bumps") {
    const ShadingPoint point = seen(bumpy_square(true, Transform{}));
    CHECK(glm::length(point.frame.to_world(point.material.smooth) - Vec3(0, 0, 1)) < 1e-5F);
    const ShadingPoint back = seen(bumpy_square(true, test::scaling(1, 1, -1)));
    CHECK(glm::length(back.frame.to_world(back.material.smooth) - Vec3(0, 0, 1)) < 1e-5F);
}

TEST_CASE("colours of vertices are stored on sRGB's curve and mixed in linear light") {
    SceneDescription scene = bumpy_square(false, Transform{});
    const auto grey = [&](float a, float b, float c) {
        auto& colours = scene.objects[0].geometries[0].colours;
        colours.clear();
        for (const float x : {a, b, c, 0.0F}) {
            colours.insert(colours.end(), 3, srgb_byte(x));
            colours.push_back(255);
        }
        return seen(scene).material.base_colour.y;
    };
    for (const float dark : {0.0018F, 0.003F, 0.0059F})
        CHECK(std::abs(grey(dark, dark, dark) - dark) < 0.0002F);
    CHECK(grey(1, 1, 1) == doctest::Approx(1));
    CHECK(grey(0, 0.5F, 1) == doctest::Approx(0.5).epsilon(0.01));
}

TEST_CASE("the layers' textures are read from the channels that glTF names") {
    SceneDescription scene = bumpy_square(true, Transform{}, {1, 1, {51, 102, 230, 204}});
    SurfaceRecord& surface = scene.materials[0].surface;
    scene.textures.push_back(scene.textures[0]);
    scene.textures[1].linear = false;
    surface.kind = *material_kind("layered");
    for (std::size_t i = 0; i < surface_textures; ++i)
        surface.textures[i].texture = has_colours(static_cast<TextureSlot>(i)) ? 1 : 0;
    surface.use(TextureSlot::normal).texture = no_id;
    surface.layers = {1, 1, 1, Vec3(1), 1, 1, Vec3(1), 1, 1.3F, 100, 600, 1, 0};
    const ShadingPoint point = seen(scene);
    const Layers& layers = point.material.layers;
    CHECK(layers.clearcoat == doctest::Approx(0.2));
    CHECK(layers.clearcoat_roughness == doctest::Approx(0.4));
    CHECK(layers.sheen.x == doctest::Approx(0.0331).epsilon(0.01));
    CHECK(layers.sheen_roughness == doctest::Approx(0.8));
    CHECK(layers.specular == doctest::Approx(0.8));
    CHECK(layers.specular_colour.y == doctest::Approx(0.1329).epsilon(0.01));
    CHECK(layers.iridescence == doctest::Approx(0.2));
    CHECK(point.material.film_thickness == doctest::Approx(300));
    CHECK(layers.anisotropy == doctest::Approx(0.902).epsilon(0.001));
    // The coat has bumps of its own; the base is flat.
    CHECK(glm::length(point.frame.z - Vec3(0, 0, 1)) < 1e-5F);
    const Vec3 coat = point.frame.to_world(point.material.coat_normal);
    const Vec3 bump = glm::normalize(Vec3(2 * 0.2F - 1, 2 * 0.4F - 1, 2 * 0.902F - 1));
    CHECK(glm::length(coat - bump) < 0.01F);
    // Direction of the texture: (-0.6, -0.2).
    const Vec3 along = point.frame.to_world(Vec3(point.material.along, 0));
    CHECK(glm::length(along - glm::normalize(Vec3(-0.6F, -0.2F, 0))) < 0.01F);
}

TEST_CASE("anisotropy follows the tangents of a placement, turned, and needs a direction") {
    SceneDescription scene = bumpy_square(true, Transform{});
    SurfaceRecord& surface = scene.materials[0].surface;
    surface.kind = *material_kind("layered");
    surface.use(TextureSlot::normal).texture = no_id;
    surface.layers.anisotropy = 1;
    const auto along = [&](const SceneDescription& description) {
        const ShadingPoint point = seen(description);
        return point.frame.to_world(Vec3(point.material.along, 0));
    };
    CHECK(glm::length(along(scene) - Vec3(1, 0, 0)) < 1e-5F);
    surface.layers.anisotropy_turn = 0.5F;
    CHECK(glm::length(along(scene) - Vec3(std::cos(0.5F), std::sin(0.5F), 0)) < 1e-5F);
    CHECK(glm::length(along(nested(scene, test::scaling(-1, 1, 1))) -
                      Vec3(-std::cos(0.5F), std::sin(0.5F), 0)) < 1e-5F);
    // Without coordinates: as smooth all around.
    scene.objects[0].geometries[0].texcoords[0].clear();
    scene.objects[0].geometries[0].tangents.clear();
    CHECK(seen(scene).material.layers.anisotropy == 0);
}
