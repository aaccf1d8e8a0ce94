// Compares a ray that enters an instance with the rows of the instance's transform.
#include "engine/bvh/visit_primitive.h"
#include "engine/math/random.h"
#include "engine/math/vec.h"

#include <doctest/doctest.h>

#include <array>

using namespace raynest;

TEST_CASE("a map by columns is the map by rows") {
    const Transform rows{{1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12}};
    const ColumnTransform columns = by_columns(rows);
    CHECK(columns == ColumnTransform{{1, 5, 9, 2, 6, 10, 3, 7, 11, 4, 8, 12}});
    CHECK(by_rows(columns) == rows);
    CHECK(by_rows(ColumnTransform{}) == Transform{});
}

TEST_CASE("an instance's columns give the bits of its rows") {
    Random random(11);
    std::array<ObjectRecord, 3> objects{};
    SceneView scene{};
    scene.objects = objects.data();
    const auto vector = [&] {
        return Vec3(random.uniform(-9, 9), random.uniform(-9, 9), random.uniform(-9, 9));
    };
    for (int i = 0; i < 1000; ++i) {
        Transform rows;
        for (float& element : rows.m) element = random.uniform(-2, 2);
        InstanceRecord instance{by_columns(rows), 2, 0xFFFFFFFFU, 40};
        const Ray world{vector(), 0.5F, vector()};
        RayView ray = outermost_view(world, &scene, 7, 3, 1);
        ray.path = 2;
        ray.tmax = 6;
        const RayView inner = enter(ray, scene, instance);
        REQUIRE(inner.origin == rows.point(world.origin));
        REQUIRE(inner.direction == rows.direction(world.direction));
        CHECK(inner.object == &objects[2]);
        CHECK(inner.path == 42);
        CHECK((inner.tmin == 0.5F && inner.tmax == 6 && inner.world == &world));
        CHECK((inner.id == 7 && inner.mask == 3 && inner.flags == 1));
    }
}
