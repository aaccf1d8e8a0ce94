// builtin:flake: Eric Haines' sphere flake ("A proposal for standard graphics environments", 1987)
// as nested instances. Generation d is one sphere and nine instances of generation d - 1 at a third
// of its size, so `depth` objects stand for 9^depth spheres.
#include "engine/assets/builtin/builtin.h"
#include "engine/geometry/sphere_shape.h"

#include <cmath>
#include <cstring>
#include <numbers>

namespace raynest {
namespace {

/// Maps a sphere to a third of its size, with its centre 4/3 away along `up` and its +Y along `up`.
Transform on_surface(const Vec3& up) {
    const Vec3 help = std::abs(up.x) < 0.9F ? Vec3(1, 0, 0) : Vec3(0, 0, 1);
    const Vec3 right = glm::normalize(glm::cross(help, up));
    const Vec3 forward = glm::cross(right, up);
    constexpr float size = 1.0F / 3;
    Transform transform;
    for (std::size_t row = 0; row < 3; ++row) {
        const auto axis = static_cast<int>(row);
        transform.m[4 * row] = size * right[axis];
        transform.m[4 * row + 1] = size * up[axis];
        transform.m[4 * row + 2] = size * forward[axis];
        transform.m[4 * row + 3] = up[axis] * (1 + size);
    }
    return transform;
}

}  // namespace

Result<SceneDescription> describe_flake(const BuiltinValues& values) {
    const auto depth = static_cast<std::uint32_t>(values.find("depth")->second);
    const Sphere sphere{Vec3(0.0F), 1};
    SceneDescription scene;
    for (std::uint32_t generation = 0; generation < depth; ++generation) {
        ObjectDescription object;
        object.name = "flake-" + std::to_string(generation);
        object.record_type = "sphere";
        object.records.resize(sizeof sphere);
        std::memcpy(object.records.data(), &sphere, sizeof sphere);
        object.record_bounds.push_back(bounds(sphere));
        for (std::uint32_t i = 0; generation != 0 && i < 9; ++i) {
            // Six around the equator, three above it, as in the original.
            const bool lower = i < 6;
            const float angle =
                std::numbers::pi_v<float> / 3 *
                (lower ? static_cast<float>(i) : 2 * static_cast<float>(i - 6) + 0.5F);
            const float latitude = lower ? 0 : 0.95F;
            const Vec3 up(std::cos(latitude) * std::cos(angle), std::sin(latitude),
                          std::cos(latitude) * std::sin(angle));
            object.instances.push_back(
                {generation - 1, on_surface(up), 0xFFFFFFFFU, i, "bud-" + std::to_string(i)});
        }
        scene.objects.push_back(std::move(object));
    }
    scene.root = depth - 1;
    return scene;
}

}  // namespace raynest
