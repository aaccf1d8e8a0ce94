// Boxes of instances: tight, but never so tight that a ray misses geometry at their sides.
#include "engine/scene/placed_box.h"

#include "engine/bvh/build.h"
#include "engine/packs/registry.h"
#include "engine/queries/range.h"
#include "engine/scene/snapshot.h"
#include "tests/conformance/answers.h"
#include "tests/conformance/scenes.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <numbers>
#include <vector>

using namespace raynest;
using conformance::Random;
using test::build_scene;
using test::place;
using test::rotation;
using test::translation;

namespace {

/// Returns a rotation, stretch and move by up to `far`, along one axis hardly at all.
Transform random_transform(Random& random, float far) {
    Vec3 x = random.direction();
    const Vec3 y = glm::normalize(glm::cross(x, random.direction()));
    Vec3 z = glm::cross(x, y);
    x *= random.between(0.5F, 2);
    z *= random.between(0.5F, 2);
    Vec3 at = random.in_box(far);
    at[static_cast<int>(random.below(3))] *= 1e-4F;
    return {{x.x, y.x, z.x, at.x, x.y, y.y, z.y, at.y, x.z, y.z, z.z, at.z}};
}

/// Returns loose triangles, or a cube. A cube's corners are vertices, so the boxes of its instances
/// are as tight as possible. Rotated leaves of loose triangles extend beyond their triangles.
GeometryDescription random_mesh(Random& random) {
    GeometryDescription mesh;
    if (random.below(2) == 0) {
        for (std::uint32_t i = 0; i < 3 * 60; ++i) {
            mesh.positions.push_back(random.direction() * random.unit());
            mesh.indices.push_back(i);
        }
    } else {
        const auto side = [](std::uint32_t bit) { return bit != 0 ? 1.0F : -1.0F; };
        for (std::uint32_t corner = 0; corner < 8; ++corner) {
            mesh.positions.emplace_back(side(corner & 1U), side(corner & 2U), side(corner & 4U));
        }
        for (const std::uint32_t axis : {1U, 2U, 4U}) {
            const std::uint32_t u = axis % 7 * 2 % 7;
            const std::uint32_t v = axis ^ u ^ 7U;
            for (const std::uint32_t from : {0U, axis}) {
                mesh.indices.insert(mesh.indices.end(),
                                    {from, from + u, from + v, from + u + v, from + v, from + u});
            }
        }
    }
    return mesh;
}

/// Returns objects: 0 holds a mesh; each of the next `levels` places the one before it a few times.
SceneDescription nested(std::uint32_t levels, float far, Random& random) {
    SceneDescription scene;
    scene.objects.resize(levels + 1);
    scene.objects[0].geometries.push_back(random_mesh(random));
    for (std::uint32_t level = 1; level <= levels; ++level) {
        for (int i = 0; i < 3; ++i) {
            scene.objects[level].instances.push_back(
                place(level - 1, random_transform(random, far)));
        }
    }
    scene.root = levels;
    return scene;
}

std::vector<Vec3> vertices_of(const SceneDescription& scene, std::uint32_t object) {
    if (object == 0) return scene.objects[0].geometries[0].positions;
    std::vector<Vec3> all;
    for (const InstanceDescription& instance : scene.objects[object].instances) {
        for (const Vec3& p : vertices_of(scene, instance.object)) {
            all.push_back(instance.transform.point(p));
        }
    }
    return all;
}

/// Returns a ray through the outermost vertex of an instance along an axis of its parent, nearly
/// along the side of its box. It starts anywhere, or above the parent's origin, where coordinates
/// are small and only the instance's own are rounded. Some rays miss the vertex by just that
/// rounding.
Ray side_ray(const SceneDescription& scene, const std::vector<std::vector<Vec3>>& vertices,
             float far, Random& random) {
    const auto instance_of = [&](std::uint32_t object) -> const Transform& {
        const auto& instances = scene.objects[object].instances;
        return instances[random.below(static_cast<std::uint32_t>(instances.size()))].transform;
    };
    std::uint32_t parent = 1 + random.below(scene.root);
    const Transform& to_parent = instance_of(parent);
    const int axis = static_cast<int>(random.below(3));
    const float sign = random.below(2) == 0 ? 1.0F : -1.0F;
    Vec3 outermost(0);
    float most = -INFINITY;
    for (const Vec3& vertex : vertices[parent - 1]) {
        const Vec3 p = to_parent.point(vertex);
        if (sign * p[axis] > most) {
            most = sign * p[axis];
            outermost = p;
        }
    }
    const bool from_afar = random.below(2) == 0;
    Vec3 direction = from_afar ? outermost : random.direction();
    direction[axis] =
        std::pow(10.0F, random.between(-9, -2)) * (random.below(2) == 0 ? 1.0F : -1.0F);
    const float distance = from_afar ? 1.0F : std::pow(10.0F, random.between(-1, 2));
    Vec3 origin = outermost - distance * direction;
    origin[axis] += sign * far * 0x1p-23F * random.between(-1, 2);
    while (parent != scene.root) {
        const Transform& up = instance_of(++parent);
        origin = up.point(origin);
        direction = up.direction(direction);
    }
    Ray ray;
    ray.origin = origin;
    ray.direction = direction;
    return ray;
}

}  // namespace

TEST_CASE("a turned disc gets the box of a disc, turned twice, too") {
    SceneDescription scene;
    scene.objects.resize(3);
    GeometryDescription& disc = scene.objects[0].geometries.emplace_back();
    constexpr std::uint32_t corners = 256;
    disc.positions.emplace_back(0, 0, 0);
    for (std::uint32_t i = 0; i < corners; ++i) {
        const float angle = 2 * std::numbers::pi_v<float> * static_cast<float>(i) / corners;
        disc.positions.emplace_back(std::cos(angle), 0, std::sin(angle));
        const std::uint32_t triangle[] = {0, 1 + i, 1 + (i + 1) % corners};
        disc.indices.insert(disc.indices.end(), std::begin(triangle), std::end(triangle));
    }
    scene.objects[1].instances = {place(0, rotation(std::numbers::pi_v<float> / 4))};
    scene.objects[2].instances = {place(1, rotation(std::numbers::pi_v<float> / 8))};
    for (scene.root = 1; scene.root <= 2; ++scene.root) {
        CAPTURE(scene.root);
        const auto snapshot = build_scene(scene);
        const Box box = snapshot->view().objects[snapshot->view().root].bounds;
        // The turned square extends to 1.41, the turned box of a disc to 1.3, the boxes of leaves
        // to 1.18.
        for (const int axis : {0, 2}) {
            CHECK(box.upper[axis] >= 0.999F);
            CHECK(box.upper[axis] < 1.2F);
            CHECK(box.lower[axis] <= -0.999F);
            CHECK(box.lower[axis] > -1.2F);
        }
    }
}

TEST_CASE("a scene's bounds are those of its vertices, as they are placed") {
    SceneDescription scene;
    scene.objects.resize(3);
    GeometryDescription& square = scene.objects[0].geometries.emplace_back();
    square.positions = {{0, 0, 0}, {1, 0, 0}, {1, 0, 1}, {0, 0, 1}};
    square.indices = {0, 1, 2, 0, 2, 3};
    scene.objects[1].instances = {place(0, translation(5e6F, 0, 0))};
    scene.root = 1;
    const auto far = build_scene(scene);
    CHECK(far->bounds().lower == Vec3(5e6F, 0, 0));
    CHECK(far->bounds().upper == Vec3(5e6F + 1, 0, 1));
    CHECK_FALSE(std::signbit(far->bounds().lower.y));

    scene.objects[1].instances = {place(0, rotation(0.3F)), place(0, translation(-3, 0, 0))};
    scene.objects[2].instances = {place(1, rotation(0.5F))};
    scene.root = 2;
    const auto turned = build_scene(scene);
    Box expected;
    for (const InstanceDescription& instance : scene.objects[1].instances)
        for (const Vec3& p : square.positions)
            expected.extend(rotation(0.5F).point(instance.transform.point(p)));
    for (int axis = 0; axis < 3; ++axis) {
        CHECK(turned->bounds().lower[axis] == doctest::Approx(expected.lower[axis]).epsilon(1e-6));
        CHECK(turned->bounds().upper[axis] == doctest::Approx(expected.upper[axis]).epsilon(1e-6));
    }
}

TEST_CASE("an empty tree has no box") {
    Content content;
    content.trees.emplace_back();
    content.objects.emplace_back();
    CHECK(placed_box(content, 0, Transform{}, 1).box.is_empty());
}

TEST_CASE("a nearly singular placement is kept and is hit") {
    SceneDescription scene;
    scene.objects.resize(2);
    GeometryDescription& geometry = scene.objects[0].geometries.emplace_back();
    geometry.positions = {{-2, -2, 0}, {2, -2, 0}, {0, 2, 0}};
    geometry.indices = {0, 1, 2};
    scene.objects[1].instances = {place(0, Transform{{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1e-21F, 0}})};
    scene.root = 1;
    const auto snapshot = build_scene(scene);
    CHECK(snapshot->view().objects[1].bounds.upper.x <= coordinate_max);
    const std::vector<Bvh> roots{{&snapshot->view(), 1}};
    Ray ray;
    ray.origin = {0, 0, 5};
    ray.direction = {0, 0, -1};
    CHECK(closest_hit(ray, roots.begin(), roots.end()).t == doctest::Approx(5));
}

TEST_CASE("rays along the sides of instances' boxes hit as in brute force") {
    const auto registry = Registry::load({{}, "auto"});
    REQUIRE(registry.has_value());
    const Variant& opaque = *(*registry)->find("opaque");
    const auto function = [&](Traversal traversal) {
        const auto found = find_function(opaque, query_closest, traversal);
        REQUIRE(found.has_value());
        return *found;
    };
    Random random(21);
    std::size_t hits = 0;
    for (int round = 0; round < 60; ++round) {
        CAPTURE(round);
        const std::uint32_t levels = 1 + random.below(4);
        const float far = std::pow(10.0F, random.between(-1, 4));
        const SceneDescription description = nested(levels, far, random);
        const auto scene = build_scene(description);
        std::vector<std::vector<Vec3>> vertices;
        for (std::uint32_t object = 0; object < levels; ++object) {
            vertices.push_back(vertices_of(description, object));
        }
        std::vector<Ray> rays(1000);
        for (Ray& ray : rays) ray = side_ray(description, vertices, far, random);
        const conformance::Question closest{query_closest, 1};
        const auto expected = conformance::ask(opaque, function(traversal_reference), scene->view(),
                                               rays, closest, {});
        const auto answer =
            conformance::ask(opaque, function(traversal_single), scene->view(), rays, closest, {});
        CHECK(conformance::differing_rays(answer, expected).rays == 0);
        hits += static_cast<std::size_t>(
            std::count_if(expected.hits.begin(), expected.hits.end(),
                          [](const HitRecord& hit) { return hit.hit != 0; }));
    }
    CHECK(hits > 60 * 1000 / 10);  // half of them miss the vertex or the triangle
}
