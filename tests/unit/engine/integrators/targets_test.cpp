// The integrators of every CPU target give the bytes of the baseline.
#include "engine/integrators/camera.h"
#include "engine/integrators/target_module.h"
#include "engine/shading/types.h"
#include "tests/unit/engine/integrators/kernel_caster.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <cstring>

using namespace raynest;

namespace {

/// Bytes without a pattern.
ImageDescription noise(std::uint32_t width, std::uint32_t height) {
    ImageDescription image{width, height,
                           std::vector<std::uint8_t>(std::size_t{4} * width * height)};
    std::uint32_t state = 1;
    for (std::uint8_t& byte : image.rgba) {
        state = state * 1664525U + 1013904223U;
        byte = static_cast<std::uint8_t>(state >> 24);
    }
    return image;
}

/// Leaning squares of many materials, with every kind of texture and light.
SceneDescription gallery() {
    SceneDescription scene;
    scene.images = {noise(64, 32), noise(16, 16), noise(8, 8)};
    scene.textures.resize(4);
    scene.textures[0].image = 0;
    scene.textures[1].image = 1;
    scene.textures[1].linear = true;
    scene.textures[2].image = 1;
    scene.textures[2].wrap_s = Wrap::mirror;
    scene.textures[2].wrap_t = Wrap::clamp;
    scene.textures[3].image = 2;
    scene.textures[3].nearest = true;
    scene.objects.resize(2);
    const auto add = [&](std::uint32_t texture) -> SurfaceRecord& {
        MaterialDescription& material = scene.materials.emplace_back();
        material.texture = texture;
        material.uv_transform = {3, 0.5F, 0.1F, -0.5F, 2, 0.7F};
        GeometryDescription square =
            test::unit_square(static_cast<std::uint32_t>(scene.materials.size() - 1));
        const auto at = static_cast<float>(scene.materials.size());
        for (Vec3& p : square.positions) p += Vec3(1.2F * at, 0.3F * p.x, 0.4F * p.y);
        square.normals = {{0.1F, 0, 1}, {-0.2F, 0.1F, 1}, {0, 0.3F, 0.9F}, {0.1F, 0.1F, 2}};
        square.colours = {255, 200, 100, 255, 255, 255, 255, 255,
                          90,  255, 255, 255, 9,   99,  199, 255};
        scene.objects[0].geometries.push_back(std::move(square));
        return material.surface;
    };
    add(0).roughness = 0.3F;
    SurfaceRecord& metal = add(2);
    metal.metallic = 1;
    metal.use(TextureSlot::metallic_roughness).texture = metal.use(TextureSlot::normal).texture = 1;
    SurfaceRecord& glass = add(3);
    glass.transmission = 1;
    glass.thickness = 1;
    glass.attenuation_distance = 0.5F;
    glass.attenuation_colour = {0.9F, 0.5F, 0.3F};
    add(no_id).emission = Vec3(3, 2, 1);
    SurfaceRecord& lamp = add(0);
    lamp.emission = Vec3(2);
    lamp.use(TextureSlot::emission).texture = 2;
    lamp.use(TextureSlot::normal).texture = 1;
    scene.objects[1].instances = {test::place(0, test::rotation(0.5F)),
                                  test::place(0, test::translation(0, 1.5F, -1))};
    scene.root = 1;
    LightDescription light;
    light.light.kind = *light_kind("spot");
    light.light.position = {3, 3, 3};
    light.light.intensity = Vec3(9);
    scene.lights = {light};
    light.light.kind = *light_kind("directional");
    light.light.direction = glm::normalize(Vec3(1, -1, -1));
    light.light.intensity = Vec3(1);
    scene.lights.push_back(light);
    return scene;
}

}  // namespace

TEST_CASE("every target that the CPU runs shades the bytes of the baseline") {
    const auto snapshot = test::build_scene(gallery());
    test::KernelCaster caster(snapshot->view());
    constexpr ImageSize size{48, 32};
    const Sensor camera = camera_sensor(*choose_camera(*snapshot, {}), {}, size);
    IntegratorSettings settings;
    settings.environment = IntegratorSettings::Environment::sky;
    settings.sun = true;
    settings.sun_azimuth = 20;
    settings.sun_elevation = 40;
    for (const char* name : {"path", "direct", "ao"}) {
        CAPTURE(name);
        const auto render = [&](std::string_view target) {
            IntegratorScene scene{{}, snapshot->bounds(), &snapshot->shading(), target};
            scene.source.scene = &snapshot->view();
            const auto made = make_integrator(name, scene, settings);
            REQUIRE(made);
            Wavefront arrays;
            Film film(size);
            REQUIRE(add_samples(**made, {camera, 0, size.pixels(), 0, 8, 5}, caster, arrays, film));
            return film;
        };
        const Film baseline = render("");
        CHECK(baseline.dropped() == 0);
        float light = 0;
        for (const float value : baseline.floats(FilmLayer::g)) light += value;
        CHECK(light > 1);
        std::size_t seen = 0;
        for (const std::string_view target : cpu_targets()) {
            if (!Registry::load({{}, std::string(target)})) continue;  // not of this CPU or build
            CAPTURE(target);
            const auto code = integrator_code(target);
            REQUIRE(code);
            REQUIRE(*code != nullptr);
            ++seen;
            const Film film = render(target);
            for (std::size_t i = 0; i < film_layers; ++i) {
                const auto layer = static_cast<FilmLayer>(i);
                CAPTURE(film_layer_table()[i].name);
                const auto a = baseline.words(layer);
                const auto b = film.words(layer);
                CHECK(std::memcmp(a.data(), b.data(), a.size_bytes()) == 0);
            }
        }
        CHECK(seen > 0);
    }
    const auto unknown = integrator_code("v9");
    REQUIRE(unknown);
    CHECK(*unknown == nullptr);
}
