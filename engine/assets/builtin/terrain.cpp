// builtin:terrain: a height field of 2 size^2 triangles in one mesh, the counterpart to the forest:
// many unique triangles, no instances.
#include "engine/assets/builtin/builtin.h"
#include "engine/assets/builtin/noise.h"

namespace raynest {
namespace {

constexpr float extent = 100;  // metres a side, centred on the origin
constexpr float relief = 22;

}  // namespace

Result<SceneDescription> describe_terrain(const BuiltinValues& values) {
    const auto cells = static_cast<std::uint32_t>(values.find("size")->second);
    const std::uint64_t seed = values.find("seed")->second;
    const std::uint32_t side = cells + 1;
    GeometryDescription geometry;
    geometry.positions.reserve(std::size_t{side} * side);
    geometry.indices.reserve(std::size_t{cells} * cells * 6);
    const auto height = [&](float x, float z) {
        // Ridges run where the noise crosses its middle, flattened towards the valleys.
        const float n = fractal_noise(x * 0.035F + 100, z * 0.035F + 100, 8, 0, seed);
        const float ridge = 1 - std::abs(2 * n - 1);
        return relief * ridge * ridge;
    };
    for (std::uint32_t j = 0; j < side; ++j) {
        for (std::uint32_t i = 0; i < side; ++i) {
            const float x = extent * (static_cast<float>(i) / static_cast<float>(cells) - 0.5F);
            const float z = extent * (static_cast<float>(j) / static_cast<float>(cells) - 0.5F);
            geometry.positions.emplace_back(x, height(x, z), z);
        }
    }
    for (std::uint32_t j = 0; j < cells; ++j) {
        for (std::uint32_t i = 0; i < cells; ++i) {
            const std::uint32_t a = j * side + i;
            for (const std::uint32_t corner : {a, a + side, a + 1, a + 1, a + side, a + side + 1}) {
                geometry.indices.push_back(corner);
            }
        }
    }
    geometry.material = 0;

    SceneDescription scene;
    scene.materials.push_back({.name = "rock", .base_colour = {0.42F, 0.38F, 0.33F, 1}});
    scene.objects.push_back({"terrain", {std::move(geometry)}, {}, {}, {}, {}, {}});
    CameraDescription camera;
    camera.name = "overview";
    // The camera looks down by 25 degrees from the south edge.
    camera.to_world.m = {1, 0, 0, 0, 0, 0.9063F, 0.4226F, 40, 0, -0.4226F, 0.9063F, 66};
    camera.yfov = 0.75F;
    camera.aspect = 16.0F / 9;
    scene.cameras.push_back(camera);
    return scene;
}

}  // namespace raynest
