// Tests the triangle test at all scales: any length that a scene may have works.
#include "engine/geometry/triangle.h"

#include "engine/queries/range.h"

#include <doctest/doctest.h>

#include <array>

using namespace raynest;

namespace {

/// Returns the hit of a ray on a tilted triangle of this size, at u = 0.3, v = 0.2, t = `t`.
HitRecord meet(float size, float t, float away = 1) {
    const std::array triangle{
        Triangle{size * Vec3(1, 0, 0.5F), size * Vec3(-0.5F, 1, -1), size * Vec3(-1, -1, 0.25F)}};
    const Vec3 target = 0.5F * triangle[0].v0 + 0.3F * triangle[0].v1 + 0.2F * triangle[0].v2;
    const Vec3 origin = size * away * Vec3(0.6F, -0.3F, 2);
    return closest_hit({origin, 0, (target - origin) / t}, triangle.begin(), triangle.end(),
                       Opaque{});
}

}  // namespace

TEST_CASE("a hit is as exact at 10^15 and at 10^-12 as at 1, whatever the ray's length") {
    for (const float size : {1e-12F, 1e-6F, 1.0F, 1e6F, 1e12F, 1e13F, 1e14F, 1e15F}) {
        for (const float t : {0.5F, 1.0F, 1e6F, size, 1e10F}) {
            CAPTURE(size);
            CAPTURE(t);
            const HitRecord hit = meet(size, t);
            REQUIRE(hit.hit == 1);
            CHECK(hit.t == doctest::Approx(t).epsilon(1e-5));
            CHECK(hit.u == doctest::Approx(0.3).epsilon(1e-5).scale(0));
            CHECK(hit.v == doctest::Approx(0.2).epsilon(1e-5).scale(0));
        }
    }
}

TEST_CASE("a ray may start far away from a large triangle") {
    const HitRecord hit = meet(1e15F, 2, 1000);
    REQUIRE(hit.hit == 1);
    CHECK(hit.t == doctest::Approx(2).epsilon(1e-4));
}
