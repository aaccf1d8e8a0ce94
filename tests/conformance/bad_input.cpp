#include "tests/conformance/bad_input.h"

#include "engine/scene/snapshot.h"

#include <cmath>
#include <limits>
#include <utility>

namespace raynest::conformance {
namespace {

SceneDescription scene_of(GeometryDescription mesh) {
    SceneDescription scene;
    scene.objects.resize(1);
    scene.objects[0].geometries.resize(1);
    scene.objects[0].geometries[0] = std::move(mesh);
    return scene;
}

void add_triangle(GeometryDescription& mesh, const Vec3& a, const Vec3& b, const Vec3& c) {
    for (const Vec3& corner : {a, b, c}) {
        mesh.indices.push_back(static_cast<std::uint32_t>(mesh.positions.size()));
        mesh.positions.push_back(corner);
    }
}

SceneDescription no_area_scene(Random& random) {
    GeometryDescription mesh;
    for (int i = 0; i < 40; ++i) {
        const Vec3 p = random.in_box(4);
        const Vec3 q = random.in_box(4);
        add_triangle(mesh, p, p, p);
        add_triangle(mesh, p, p, q);
        add_triangle(mesh, p, q, p);
        add_triangle(mesh, q, p, p);
    }
    return scene_of(std::move(mesh));
}

SceneDescription coincident_scene() {
    GeometryDescription mesh;
    mesh.positions = {{-2, -2, 0.5F}, {2, -1, 0}, {0, 2, -0.5F}};
    for (int copy = 0; copy < 1000; ++copy) mesh.indices.insert(mesh.indices.end(), {0, 1, 2});
    return scene_of(std::move(mesh));
}

SceneDescription needle_scene(Random& random) {
    constexpr float length = 1e6F;
    GeometryDescription mesh;
    for (int i = 0; i < 60; ++i) {
        const Vec3 at = random.in_box(2);
        const Vec3 along = i < 3 ? Vec3(i == 0, i == 1, i == 2) : random.direction();
        const float width = std::pow(10.0F, static_cast<float>(-(i % 7)));
        add_triangle(mesh, at, at + length * along, at + width * random.direction());
    }
    return scene_of(std::move(mesh));
}

/// A bent sheet that spans the range of coordinates, with triangles of a few units in the last
/// place around its corners; with `unit` 1 it reaches the limit.
SceneDescription far_scene(float unit, Random& random) {
    SceneDescription scene = sheet_scene(128, 1, 9);
    GeometryDescription& mesh = scene.objects[0].geometries[0];
    const float reach = unit * coordinate_max;
    for (Vec3& p : mesh.positions) p *= reach / 2;
    for (int i = 0; i < 40; ++i) {
        const Vec3 at = Vec3(i & 1 ? 1 : -1, i & 2 ? 1 : -1, i & 4 ? 1 : -1) * (0.9999F * reach);
        const float size = reach * 0x1p-20F;
        add_triangle(mesh, at, at + size * random.direction(), at + size * random.direction());
    }
    return scene;
}

SceneDescription placed(SceneDescription scene, float scale) {
    InstanceDescription instance;
    instance.object = 0;
    for (const std::size_t i : {0U, 5U, 10U}) instance.transform.m[i] = scale;
    scene.objects.emplace_back().instances.push_back(instance);
    scene.root = 1;
    return scene;
}

/// Groups of 64 rays share an origin and aim at neighbouring points, so that packets are traversed.
std::vector<Ray> packet_rays(const SceneDescription& scene, std::uint32_t count, float half,
                             Random& random) {
    std::vector<Ray> rays(count);
    Vec3 origin, target;
    for (std::uint32_t i = 0; i < count; ++i) {
        if (i % 64 == 0) {
            origin = 3 * half * random.direction();
            target = random_edge_point(scene, random);
        }
        rays[i].origin = origin;
        rays[i].direction = target + random.in_box(0.05F * half) - origin;
    }
    return rays;
}

}  // namespace

std::vector<Ray> invalid_rays() {
    constexpr float inf = std::numeric_limits<float>::infinity();
    constexpr float nan = std::numeric_limits<float>::quiet_NaN();
    std::vector<Ray> rays;
    const auto add = [&](auto&& spoil) {
        Ray ray{Vec3(0, 0, 9), 0, Vec3(0, 0, -1)};
        spoil(ray);
        rays.push_back(ray);
    };
    for (int axis = 0; axis < 3; ++axis) {
        for (const float bad : {nan, inf, -inf}) {
            add([&](Ray& ray) { ray.origin[axis] = bad; });
            add([&](Ray& ray) { ray.direction[axis] = bad; });
        }
    }
    add([](Ray& ray) { ray.direction = Vec3(0); });
    add([](Ray& ray) { ray.direction = Vec3(-0.0F); });
    for (const float bad : {nan, inf, -inf, -1.0F, -1e-40F}) {
        add([&](Ray& ray) { ray.tmin = bad; });
    }
    for (const float bad : {nan, -inf, -1.0F}) add([&](Ray& ray) { ray.tmax = bad; });
    add([](Ray& ray) { ray.tmin = 2, ray.tmax = 1; });
    add([](Ray& ray) { ray.tmin = 1, ray.tmax = std::nextafter(1.0F, 0.0F); });
    return rays;
}

std::vector<BadInput> bad_inputs(std::uint32_t rays_each, Random& random) {
    std::vector<BadInput> inputs;
    const auto add = [&](const char* name, std::uint32_t depth, SceneDescription scene,
                         float half) -> std::vector<Ray>& {
        std::vector<Ray> rays = packet_rays(scene, rays_each, half, random);
        for (const auto& more :
             {edge_rays(scene, rays_each, half, random), random_rays(rays_each / 4, half, random),
              odd_rays(rays_each / 4, half, random)}) {
            rays.insert(rays.end(), more.begin(), more.end());
        }
        inputs.push_back({name, depth, std::move(scene), std::move(rays)});
        return inputs.back().rays;
    };
    std::vector<Ray>& mixed = add("invalid-rays", 1, sheet_scene(128, 1, 3), 4);
    const std::vector<Ray> invalid = invalid_rays();
    for (std::size_t i = 0; i < mixed.size(); i += 2) mixed[i] = invalid[i / 2 % invalid.size()];
    add("no-area", 1, no_area_scene(random), 8);
    add("coincident", 1, coincident_scene(), 4);
    add("needles", 1, needle_scene(random), 8);
    add("far", 1, far_scene(1, random), coordinate_max);
    add("far-placed", 2, placed(far_scene(1e-12F, random), 0.9e12F), coordinate_max);
    add("far-shrunk", 2, placed(far_scene(1, random), 8e-15F), 16);
    return inputs;
}

}  // namespace raynest::conformance
