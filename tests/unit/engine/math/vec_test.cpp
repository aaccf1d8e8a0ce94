#include "engine/math/vec.h"

#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <limits>
#include <random>

using namespace raynest;
using test::rotation;
using test::scaling;
using test::translation;

namespace {

float largest_difference(const Transform& a, const Transform& b) {
    float largest = 0;
    for (std::size_t i = 0; i < 12; ++i) largest = std::max(largest, std::abs(a.m[i] - b.m[i]));
    return largest;
}

Transform random_transform(std::mt19937& random) {
    std::uniform_real_distribution<float> value(-2, 2);
    Transform t;
    for (float& element : t.m) element = value(random);
    return t;
}

}  // namespace

TEST_CASE("compose applies the inner transform first") {
    const Transform moved_then_scaled = compose(scaling(2, 2, 2), translation(1, 0, 0));
    CHECK(moved_then_scaled.point({0, 0, 0}) == Vec3(2, 0, 0));
    CHECK(moved_then_scaled.direction({0, 1, 0}) == Vec3(0, 2, 0));
}

TEST_CASE("a transform composed with its inverse is the identity") {
    std::mt19937 random(1);
    for (int i = 0; i < 1000; ++i) {
        const Transform t = random_transform(random);
        Transform inverse;
        REQUIRE(invert(t, inverse));
        CHECK(largest_difference(compose(inverse, t), Transform{}) < 1e-5F * condition(t));
    }
}

TEST_CASE("mirrored, tiny and huge transforms have inverses") {
    Transform inverse;
    CHECK(invert(scaling(-1, 1, 1), inverse));
    CHECK(inverse == scaling(-1, 1, 1));
    CHECK(invert(scaling(1e-20F, 1e-20F, 1e-20F), inverse));
    CHECK(inverse.m[0] == doctest::Approx(1e20F));
    CHECK(invert(scaling(1e30F, 1, 1), inverse));
}

TEST_CASE("singular transforms are refused and leave a zero inverse") {
    constexpr float nan = std::numeric_limits<float>::quiet_NaN();
    constexpr float infinity = std::numeric_limits<float>::infinity();
    // The last but one has rank two, with elements that no float represents exactly.
    const Transform rank_two{{0.1F, 0.2F, 0.3F, 0, 0.4F, 0.5F, 0.6F, 0, 0.5F, 0.7F, 0.9F, 0}};
    Transform sum_of_rows = rank_two;
    for (std::size_t c = 0; c < 3; ++c) sum_of_rows.m[8 + c] = 2 * sum_of_rows.m[c];
    for (const Transform& t : {scaling(0, 1, 1), scaling(0, 0, 0), scaling(nan, 1, 1),
                               scaling(infinity, 1, 1), scaling(1e-39F, 1, 1), sum_of_rows}) {
        Transform inverse;
        CHECK_FALSE(invert(t, inverse));
        CHECK(std::all_of(inverse.m.begin(), inverse.m.end(), [](float x) { return x == 0; }));
    }
}

TEST_CASE("the condition number is the ratio of the axes, whatever the rotation") {
    CHECK(condition(Transform{}) == 1.0F);
    CHECK(condition(rotation(0.7F)) == doctest::Approx(1.0F).epsilon(1e-6));
    CHECK(condition(scaling(-3, 3, 3)) == 1.0F);
    CHECK(condition(scaling(1, 5, 10)) == doctest::Approx(10.0F));
    CHECK(condition(compose(rotation(1), compose(scaling(1, 5, 10), rotation(2)))) ==
          doctest::Approx(10.0F).epsilon(1e-5));
    // Small singular values keep their digits.
    CHECK(condition(compose(rotation(1), scaling(1, 1e-6F, 1))) ==
          doctest::Approx(1e6F).epsilon(1e-3));
    CHECK(condition(scaling(0, 1, 1)) == std::numeric_limits<float>::infinity());
}
