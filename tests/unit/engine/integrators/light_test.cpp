// Path-traced and direct light against closed forms.
#include "engine/integrators/integrator.h"
#include "engine/integrators/lighting.h"
#include "engine/shading/types.h"
#include "tests/unit/engine/integrators/kernel_caster.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <cmath>
#include <cstring>
#include <numbers>

using namespace raynest;

namespace {

constexpr double tau = 2 * std::numbers::pi;

MaterialDescription diffuse(float albedo, float emission = 0) {
    MaterialDescription material;
    material.base_colour = Vec4(Vec3(albedo), 1);
    material.surface.emission = Vec3(emission);
    material.surface.roughness = 1;
    material.surface.ior = 1;  // no varnish: purely diffuse
    return material;
}

/// A rectangle around a centre, spanned by two half axes; its normal is their cross product.
GeometryDescription rectangle(const Vec3& centre, const Vec3& x, const Vec3& y,
                              std::uint32_t material) {
    GeometryDescription g = test::unit_square(material);
    g.positions = {centre - x - y, centre + x - y, centre + x + y, centre - x + y};
    return g;
}

struct Mean {
    double value = 0, error = 0;  ///< the mean over all samples
};

/// A scene and an orthographic camera above a point, as wide as a pixel's share of `width`.
struct Stage {
    explicit Stage(const SceneDescription& description, const char* variant = "opaque")
        : scene(test::build_scene(description)),
          caster(scene->view(), variant) {}

    Mean measure(const char* name, IntegratorSettings settings, const glm::dvec3& eye, double width,
                 std::uint32_t samples = 4096) {
        // Straight down.
        const Sensor camera =
            Orthographic{{{{1, 0, 0}, {0, 0, -1}, {0, 1, 0}, eye}}, {1, 1}, width, width};
        IntegratorScene in{{}, scene->bounds(), &scene->shading()};
        in.source.scene = &scene->view();
        const auto made = make_integrator(name, in, settings);
        REQUIRE(made);
        notes = (*made)->notes();
        Film film({1, 1});
        REQUIRE(add_samples(**made, {camera, 0, 1, 0, samples, 1}, caster, arrays, film));
        CHECK(film.dropped() == 0);
        // Scrambled points have less error than the variance of their samples says.
        return {static_cast<double>(film.colour(0).y), static_cast<double>(film.error(0))};
    }

    std::shared_ptr<const Snapshot> scene;
    test::KernelCaster caster;
    Wavefront arrays;
    std::vector<std::string> notes;
};

/// 4,096 samples come within three standard errors; 32,768 show what is a few percent off.
/// Schlick's term reflects 0.4 % even without a border.
void check_near(Stage& stage, const char* name, const IntegratorSettings& settings,
                const glm::dvec3& eye, double width, double exact) {
    for (const std::uint32_t samples : {4096U, 32768U}) {
        const Mean mean = stage.measure(name, settings, eye, width, samples);
        CAPTURE(samples);
        CAPTURE(mean.value);
        CAPTURE(mean.error);
        CAPTURE(exact);
        CHECK(std::abs(mean.value - exact) < 3 * mean.error + 5e-3 * exact);
        CHECK(mean.error < 0.05 * exact);
    }
}

SceneDescription scene_of(std::vector<GeometryDescription> geometries,
                          std::vector<MaterialDescription> materials) {
    SceneDescription scene;
    scene.objects.resize(1);
    scene.objects[0].geometries = std::move(geometries);
    scene.materials = std::move(materials);
    return scene;
}

IntegratorSettings lit_by(IntegratorSettings::Environment environment) {
    IntegratorSettings settings;
    settings.depth = 256;
    settings.environment = environment;
    return settings;
}
constexpr auto none = IntegratorSettings::Environment::none;

}  // namespace

TEST_CASE("an enclosure that emits and reflects everywhere has the sum of a geometric series") {
    std::vector<GeometryDescription> sides;
    const Vec3 x(1, 0, 0), y(0, 1, 0), z(0, 0, 1);
    for (const float s : {-1.0F, 1.0F}) {
        sides.push_back(rectangle(s * x, y, z, 0));
        sides.push_back(rectangle(s * y, z, x, 0));
        sides.push_back(rectangle(s * z, x, y, 0));
    }
    Stage stage(scene_of(sides, {diffuse(0.6F, 0.4F)}));
    check_near(stage, "path", lit_by(none), {0, 0.5, 0}, 1, 0.4 / (1 - 0.6));
    // Direct light: emission and one reflection.
    check_near(stage, "direct", lit_by(none), {0, 0.5, 0}, 1, 0.4 + 0.6 * 0.4);
}

TEST_CASE("a rectangle lights a point as its form factor says") {
    const std::vector<GeometryDescription> parts = {
        rectangle({0, 0, 0}, {0, 0, 5}, {5, 0, 0}, 0),
        rectangle({0, 2, 0}, {0.5F, 0, 0}, {0, 0, 0.7F}, 1)};
    Stage stage(scene_of(parts, {diffuse(0.5F), diffuse(0, 10)}));
    // Four times the factor of a corner.
    const double a = 0.5 / 2, b = 0.7 / 2;
    const double ra = std::sqrt(1 + a * a), rb = std::sqrt(1 + b * b);
    const double factor = 4 * (a / ra * std::atan(b / ra) + b / rb * std::atan(a / rb)) / tau;
    check_near(stage, "direct", lit_by(none), {0, 1, 0}, 1e-3, 0.5 * 10 * factor);
    check_near(stage, "path", lit_by(none), {0, 1, 0}, 1e-3, 0.5 * 10 * factor);
}

TEST_CASE("a lamp that no ray can enter lights nothing") {
    for (const std::uint32_t mask : {~0U, 0U}) {
        SceneDescription scene = scene_of({rectangle({0, 2, 0}, {0.5F, 0, 0}, {0, 0, 0.7F}, 1)},
                                          {diffuse(0.5F), diffuse(0, 10)});
        scene.objects.resize(2);
        scene.objects[1].geometries = {rectangle({0, 0, 0}, {0, 0, 5}, {5, 0, 0}, 0)};
        scene.objects[1].instances.push_back({0, {}, mask, 0, "lamp"});
        scene.root = 1;
        Stage stage(scene);
        for (const char* integrator : {"direct", "path"})
            CHECK((stage.measure(integrator, lit_by(none), {0, 1, 0}, 1e-3).value > 0) ==
                  (mask != 0));
    }
}

TEST_CASE("an unlit surface is seen, and lights nothing") {
    std::vector<GeometryDescription> parts = {rectangle({0, 0, 0}, {0, 0, 5}, {5, 0, 0}, 0),
                                              rectangle({0, 2, 0}, {5, 0, 0}, {0, 0, 5}, 1)};
    MaterialDescription unlit = diffuse(0.8F);
    unlit.surface.kind = *material_kind("unlit");
    Stage stage(scene_of(parts, {diffuse(0.5F), unlit}));
    CHECK(stage.measure("path", lit_by(none), {0, 1, 0}, 1e-3).value == 0);
    CHECK(stage.measure("path", lit_by(none), {0, 3, 0}, 1e-3).value == doctest::Approx(0.8));
}

TEST_CASE("a lamp is a light also where few texels of its picture are lit") {
    const std::vector<GeometryDescription> parts = {
        rectangle({0, 0, 0}, {0, 0, 5}, {5, 0, 0}, 0),
        rectangle({0, 2, 0}, {0.5F, 0, 0}, {0, 0, 0.5F}, 1)};
    const auto below = [&](std::uint32_t side, std::initializer_list<std::uint32_t> lit) {
        SceneDescription scene = scene_of(parts, {diffuse(0.5F), diffuse(0, 1000)});
        ImageDescription picture{side, side, {}};
        picture.rgba.resize(std::size_t{4} * side * side);
        for (const std::uint32_t texel : lit)
            std::fill_n(&picture.rgba[std::size_t{4} * texel], 3, std::uint8_t{255});
        scene.images.push_back(picture);
        scene.textures.push_back({0});
        scene.materials[1].surface.use(TextureSlot::emission).texture = 0;
        return Stage(scene);
    };
    for (const std::uint32_t side : {128U, 1024U}) {
        Stage stage = below(side, {0});
        (void)stage.measure("direct", lit_by(none), {0, 1, 0}, 1e-3, 4);
        CHECK(stage.notes.empty());
    }
    // The four in the middle of 16^2 are nearly a point 2 m above, which sends what their share of
    // the lamp's square metre does; the mean square of their distance from it is 0.00325 m^2.
    Stage stage = below(16, {7 * 16 + 7, 7 * 16 + 8, 8 * 16 + 7, 8 * 16 + 8});
    const double lit = 1000.0 * 4 / 256 / (2 * 2) * (1 - 2 * 0.00325 / (2 * 2));
    const double exact = 0.5 / std::numbers::pi * lit;
    const Mean mean = stage.measure("direct", lit_by(none), {0, 1, 0}, 1e-3, 1U << 17);
    CHECK(std::abs(mean.value - exact) < 3 * mean.error);
    CHECK(mean.error < 0.02 * exact);
}

TEST_CASE("a sphere lights a point by the square of its apparent size") {
    GeometryDescription sphere;
    constexpr std::uint32_t rows = 64, columns = 128;
    for (std::uint32_t r = 0; r <= rows; ++r) {
        for (std::uint32_t c = 0; c <= columns; ++c) {
            const double polar = std::numbers::pi * r / rows, around = tau * c / columns;
            sphere.positions.push_back(
                Vec3(0, 3, 0) + Vec3(glm::dvec3(std::sin(polar) * std::cos(around), std::cos(polar),
                                                std::sin(polar) * std::sin(around))));
        }
    }
    for (std::uint32_t r = 0; r < rows; ++r) {
        for (std::uint32_t c = 0; c < columns; ++c) {
            const std::uint32_t i = r * (columns + 1) + c;
            for (const std::uint32_t corner :
                 {i, i + 1, i + columns + 1, i + 1, i + columns + 2, i + columns + 1})
                sphere.indices.push_back(corner);
        }
    }
    sphere.material = 1;
    Stage stage(scene_of({rectangle({0, 0, 0}, {0, 0, 5}, {5, 0, 0}, 0), sphere},
                         {diffuse(1), diffuse(0, 9)}));
    check_near(stage, "direct", lit_by(none), {0, 1, 0}, 1e-3, 9.0 / 9);
}

TEST_CASE("lights of a file light a plane by the cosine over the squared distance") {
    SceneDescription scene =
        scene_of({rectangle({0, 0, 0}, {0, 0, 5}, {5, 0, 0}, 0)}, {diffuse(1)});
    LightDescription light;
    light.light.kind = *light_kind("point");
    light.light.position = {3, 4, 0};
    light.light.intensity = Vec3(100);
    scene.lights = {light};
    Stage stage(scene);
    const double exact = 100.0 / 25 * 0.8 / std::numbers::pi;
    const Mean mean = stage.measure("direct", lit_by(none), {0, 1, 0}, 1e-3, 64);
    // Schlick's term reflects at grazing angles even without a border.
    CHECK(mean.value == doctest::Approx(exact).epsilon(5e-3).scale(0));
    CHECK(stage.notes.empty());
}

TEST_CASE("a plane under a uniform sky reflects its albedo of it") {
    Stage stage(scene_of({rectangle({0, 0, 0}, {0, 0, 50}, {50, 0, 0}, 0)}, {diffuse(0.7F)}));
    auto settings = lit_by(IntegratorSettings::Environment::picture);
    auto picture = std::make_shared<EnvironmentPicture>();
    picture->size = {16, 8};
    picture->pixels.assign(128, Vec3(2));
    settings.picture = picture;
    check_near(stage, "path", settings, {0, 1, 0}, 1, 1.4);
    check_near(stage, "direct", settings, {0, 1, 0}, 1, 1.4);
}

TEST_CASE("white metal whose bumps lean anywhere reflects a white sky at a grazing view") {
    auto settings = lit_by(IntegratorSettings::Environment::picture);
    auto picture = std::make_shared<EnvironmentPicture>();
    picture->size = {16, 8};
    picture->pixels.assign(128, Vec3(1));
    settings.picture = picture;
    const double up = tau / 36;  // 10 degrees: the camera looks down
    const Vec3 along(glm::dvec3(0, std::cos(up), -std::sin(up)));
    for (const auto& [x, y] : {std::pair{218, 128}, {37, 128}, {128, 218}, {128, 37}}) {
        SceneDescription scene =
            scene_of({rectangle({0, 0, 0}, {5, 0, 0}, 5.0F * along, 0)}, {diffuse(1)});
        scene.materials[0].surface.metallic = 1;
        scene.materials[0].surface.roughness = 0.01F;
        scene.materials[0].surface.use(TextureSlot::normal).texture = 0;
        scene.images.push_back(
            {1, 1, {static_cast<std::uint8_t>(x), static_cast<std::uint8_t>(y), 218, 255}});
        scene.textures.push_back({0});
        scene.textures[0].linear = true;
        Stage stage(scene);
        CAPTURE(x);
        CAPTURE(y);
        for (const char* name : {"path", "direct"}) {
            const Mean mean = stage.measure(name, settings, {0, 9, 0}, 1);
            CAPTURE(mean.value);
            CHECK(std::abs(mean.value - 1) < 5e-3);
        }
    }
}

TEST_CASE("a picture stands as three.js places it, and turns from -Z towards +X") {
    const SceneDescription scene =
        scene_of({rectangle({0, -9, 0}, {0, 0, 1}, {1, 0, 0}, 0)}, {diffuse(1)});
    constexpr std::uint32_t width = 64;
    auto picture = std::make_shared<EnvironmentPicture>();
    picture->size = {width, 32};
    for (std::uint32_t i = 0; i < width * 32; ++i)
        picture->pixels.emplace_back(static_cast<float>(1 + i % width));
    const auto built = test::build_scene(scene);
    IntegratorScene in{{}, built->bounds(), &built->shading()};
    in.source.scene = &built->view();
    auto settings = lit_by(IntegratorSettings::Environment::picture);
    settings.picture = picture;
    for (const float rotate : {0.0F, 45.0F, -90.0F, 360.0F, -360.0F}) {
        settings.environment_rotate = rotate;
        const Lighting lighting(in, settings);
        CAPTURE(rotate);
        for (std::uint32_t column = 0; column < width; ++column) {
            // equirectUv() of three.js, backwards: u = atan2(z, x) / 2 pi + 1/2.
            const double angle =
                ((column + 0.5) / width - 0.5 + static_cast<double>(rotate) / 360) * tau;
            const Vec3 direction(glm::dvec3(std::cos(angle), 0, std::sin(angle)));
            CAPTURE(column);
            CHECK(lighting.far(direction).radiance.x ==
                  doctest::Approx(1 + column).epsilon(column % (width - 1) == 0 ? 1e-2 : 1e-4));
        }
    }
    CHECK(Lighting(in, settings).notes().empty());
    picture->left_out = 3;
    const Lighting lighting(in, settings);
    REQUIRE(lighting.notes().size() == 1);
    CHECK(lighting.notes()[0].starts_with("the environment has 3 pixels of 2048 "));
}

TEST_CASE("auto is the sky unless the file has lights, and a note says what was chosen") {
    LightDescription lamp;
    lamp.light.kind = *light_kind("point");
    lamp.light.intensity = Vec3(1);
    for (const bool emits : {false, true}) {
        for (const bool has_light : {false, true}) {
            SceneDescription scene = scene_of({rectangle({0, -9, 0}, {0, 0, 1}, {1, 0, 0}, 0)},
                                              {diffuse(0.5F, emits ? 1.0F : 0.0F)});
            if (has_light) scene.lights = {lamp};
            const auto built = test::build_scene(scene);
            IntegratorScene in{{}, built->bounds(), &built->shading()};
            in.source.scene = &built->view();
            const Lighting lighting(in, {});
            CAPTURE(emits);
            CAPTURE(has_light);
            CHECK(is_black(lighting.far(Vec3(0, 1, 0)).radiance) == has_light);
            REQUIRE(lighting.notes().size() == 1);
            const std::string& note = lighting.notes()[0];
            CHECK(note.find(has_light ? "without a sky" : "a clear sky") != std::string::npos);
            CHECK(note.find("`environment`") != std::string::npos);
            CHECK((note.find("emit") != std::string::npos) == (emits && !has_light));
            IntegratorSettings with_sun;
            with_sun.sun = true;
            with_sun.sun_elevation = 30;
            CHECK_FALSE(is_black(Lighting(in, with_sun).far(Vec3(0, 1, 0)).radiance));
        }
    }
}

TEST_CASE("a plane under the physical sky reflects sky and sun") {
    Stage stage(scene_of({rectangle({0, 0, 0}, {0, 0, 50}, {50, 0, 0}, 0)}, {diffuse(0.5F)}));
    auto settings = lit_by(IntegratorSettings::Environment::sky);
    settings.sun = true;
    settings.sun_azimuth = 100;
    settings.sun_elevation = 50;
    const Sky sky = make_sky(100, 50);
    const double exact =
        0.5 / std::numbers::pi *
        static_cast<double>(sky.environment.irradiance_up().y +
                            sky.sun.radiance.y / sky.sun.density() * sky.sun.direction.y);
    check_near(stage, "path", settings, {0, 1, 0}, 1, exact);
    CHECK(stage.notes.empty());
    // The same sky on its own, because there is nothing else.
    static_cast<void>(stage.measure("path", {}, {0, 1, 0}, 1, 4));
    REQUIRE(stage.notes.size() == 1);
    CHECK(stage.notes[0].find("sky") != std::string::npos);
}

TEST_CASE("the sun shines through a leaf's holes") {
    // A leaf of 8 x 8 texels with 24 holes, nearest: three eighths of the light passes.
    SceneDescription scene = scene_of({rectangle({0, 0, 0}, {0, 0, 5}, {5, 0, 0}, 0),
                                       rectangle({0, 2, 0}, {0, 0, 1}, {1, 0, 0}, 1)},
                                      {diffuse(1), diffuse(0)});
    ImageDescription image{8, 8, std::vector<std::uint8_t>(256, 255)};
    for (std::size_t i = 0; i < 64; ++i)
        if (i % 8 < 3) image.rgba[4 * i + 3] = 0;
    scene.images = {image};
    TextureDescription texture;
    texture.image = 0;
    texture.nearest = true;
    scene.textures = {texture};
    scene.materials[1].texture = 0;
    scene.materials[1].alpha_mode = AlphaMode::mask;
    LightDescription sun;
    sun.light.kind = *light_kind("directional");
    sun.light.direction = {0, -1, 0};
    sun.light.intensity = Vec3(static_cast<float>(std::numbers::pi));
    scene.lights = {sun};
    Stage stage(scene, "alpha_mask");
    check_near(stage, "direct", lit_by(none), {0, 1, 0}, 1.98, 3.0 / 8);
}

TEST_CASE("blended surfaces let light pass in proportion to their alpha") {
    SceneDescription scene = scene_of({rectangle({0, 0, 0}, {0, 0, 5}, {5, 0, 0}, 0),
                                       rectangle({0, 2, 0}, {0, 0, 1}, {1, 0, 0}, 1)},
                                      {diffuse(1), diffuse(0)});
    scene.materials[1].alpha_mode = AlphaMode::blend;
    scene.materials[1].base_colour = {0, 0, 0, 0.3F};
    LightDescription sun;
    sun.light.kind = *light_kind("directional");
    sun.light.direction = {0, -1, 0};
    sun.light.intensity = Vec3(static_cast<float>(std::numbers::pi));
    scene.lights = {sun};
    Stage stage(scene, "alpha_blend");
    check_near(stage, "direct", lit_by(none), {0, 1, 0}, 1.9, 0.7);
    // The camera looks through it, too.
    check_near(stage, "direct", lit_by(none), {0, 3, 0}, 1.9, 0.7 * 0.7);
}

TEST_CASE("a bulge of few triangles has the shadow of the smooth surface") {
    // A ball of 8 x 16 facets; one of them stands across the border of the shadow.
    GeometryDescription ball;
    constexpr std::uint32_t rows = 8, columns = 16;
    for (std::uint32_t r = 0; r <= rows; ++r) {
        for (std::uint32_t c = 0; c <= columns; ++c) {
            const double polar = std::numbers::pi * r / rows, around = tau * (c + 0.5) / columns;
            ball.positions.push_back(
                Vec3(glm::dvec3(std::sin(polar) * std::cos(around), std::cos(polar),
                                -std::sin(polar) * std::sin(around))));
        }
    }
    for (std::uint32_t r = 0; r < rows; ++r) {
        for (std::uint32_t c = 0; c < columns; ++c) {
            const std::uint32_t i = r * (columns + 1) + c;
            for (const std::uint32_t corner :
                 {i, i + columns + 1, i + 1, i + 1, i + columns + 1, i + columns + 2})
                ball.indices.push_back(corner);
        }
    }
    const GeometryDescription facets = ball;
    ball.normals = ball.positions;
    LightDescription sun;
    sun.light.kind = *light_kind("directional");
    sun.light.direction = glm::normalize(Vec3(-1, 0.05F, 0));
    sun.light.intensity = Vec3(static_cast<float>(std::numbers::pi));
    const auto lit = [&](const GeometryDescription& geometry, double azimuth) {
        SceneDescription scene = scene_of({geometry}, {diffuse(0.5F)});
        scene.lights = {sun};
        Stage stage(scene);
        return stage.measure("direct", lit_by(none),
                             {0.85 * std::cos(azimuth), 2, -0.85 * std::sin(azimuth)}, 1e-3, 64);
    };
    const double turn = tau / 360;
    // The facet turns away from the light. Its smooth surface does so beyond 88 degrees only.
    CHECK(lit(facets, 83 * turn).value == 0);
    for (const double azimuth : {80 * turn, 83 * turn}) {
        CAPTURE(azimuth);
        // The vertices' normals, as the triangles mix them.
        const double part = (azimuth / turn - 78.75) / 22.5;
        const double sine = 0.85 / 0.9808;
        const double along =
            sine * ((1 - part) * std::cos(78.75 * turn) + part * std::cos(101.25 * turn));
        const double seen =
            (along - 0.05 * std::sqrt(1 - sine * sine)) / std::sqrt(1 + 0.05 * 0.05);
        CHECK(lit(ball, azimuth).value == doctest::Approx(0.5 * seen).epsilon(0.25));
    }
    CHECK(lit(ball, 95 * turn).value == 0);
    CHECK(lit(ball, 100 * turn).value == 0);
    // Flat and hollow surfaces are as before.
    GeometryDescription flat = rectangle({0, 0, 0}, {0, 0, 5}, {5, 0, 0}, 0);
    const Mean bare = lit(flat, 0.3);
    flat.normals.assign(4, Vec3(0, 1, 0));
    CHECK(lit(flat, 0.3).value == bare.value);
    // Normals far from those of a flat floor carry no light over a wall.
    flat.normals = {Vec3(-1, 1, -1), Vec3(1, 1, -1), Vec3(1, 1, 1), Vec3(-1, 1, 1)};
    SceneDescription walled =
        scene_of({flat, rectangle({2, 0, 0}, {0, 0.5F, 0}, {0, 0, 5}, 0)}, {diffuse(0.5F)});
    walled.lights = {sun};
    CHECK(Stage(walled).measure("direct", lit_by(none), {1, 2, 0.5}, 1e-3, 64).value == 0);
}

TEST_CASE("Beer's law: glass takes its colour from the way through it") {
    // A slab one metre thick above a lamp; rays pass straight down.
    SceneDescription scene = scene_of({rectangle({0, 0, 0}, {0, 0, 5}, {5, 0, 0}, 0),
                                       rectangle({0, 2, 0}, {0, 0, 5}, {5, 0, 0}, 1),
                                       rectangle({0, 1, 0}, {5, 0, 0}, {0, 0, 5}, 1)},
                                      {diffuse(0, 1), diffuse(1)});
    SurfaceRecord& glass = scene.materials[1].surface;
    glass.roughness = 0;
    glass.transmission = 1;
    glass.thickness = 1;
    glass.ior = 1.0001F;
    glass.attenuation_distance = 2;
    glass.attenuation_colour = Vec3(0.25F);
    Stage stage(scene);
    const Mean mean = stage.measure("path", lit_by(none), {0, 3, 0}, 1, 1024);
    CHECK(mean.value == doctest::Approx(0.5).epsilon(0.03));
}

TEST_CASE("lit pictures have the same bytes in passes, in chunks and at once") {
    SceneDescription scene = test::tree_scene();
    const auto snapshot = test::build_scene(scene);
    test::KernelCaster caster(snapshot->view());
    const Sensor camera = camera_sensor(*choose_camera(*snapshot, {}), {}, {24, 16});
    IntegratorScene in{{}, snapshot->bounds(), &snapshot->shading()};
    in.source.scene = &snapshot->view();
    for (const char* name : {"direct", "path"}) {
        const auto integrator = make_integrator(name, in, {});
        REQUIRE(integrator);
        Wavefront arrays;
        Film whole({24, 16}), parts({24, 16});
        REQUIRE(add_samples(**integrator, {camera, 0, 384, 0, 6, 3}, caster, arrays, whole));
        for (std::uint64_t first = 0; first < 384; first += 50)
            for (std::uint32_t s = 0; s < 6; s += 3)
                REQUIRE(
                    add_samples(**integrator,
                                {camera, first, std::min<std::uint64_t>(50, 384 - first), s, 3, 3},
                                caster, arrays, parts));
        for (std::size_t i = 0; i < film_layers; ++i) {
            const auto a = whole.words(static_cast<FilmLayer>(i));
            const auto b = parts.words(static_cast<FilmLayer>(i));
            CHECK(std::memcmp(a.data(), b.data(), a.size_bytes()) == 0);
        }
    }
}
