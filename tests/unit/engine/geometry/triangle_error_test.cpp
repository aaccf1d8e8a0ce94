// The error of t, u and v against exact arithmetic, over twelve orders of magnitude of size and
// aspect.
#include "engine/geometry/sphere.h"
#include "engine/geometry/triangle.h"
#include "engine/queries/range.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <random>

using namespace raynest;

namespace {

struct Exact {
    long double x, y, z;
    explicit Exact(const Vec3& v) : x(v.x), y(v.y), z(v.z) {}
    Exact(long double a, long double b, long double c) : x(a), y(b), z(c) {}
};
Exact operator-(const Exact& a, const Exact& b) {
    return {a.x - b.x, a.y - b.y, a.z - b.z};
}
Exact cross(const Exact& a, const Exact& b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
long double dot(const Exact& a, const Exact& b) {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}
Exact absolute(const Exact& a) {
    return {std::abs(a.x), std::abs(a.y), std::abs(a.z)};
}
/// Returns the cross product with all products added: what its rounding is relative to.
Exact cross_size(const Exact& a, const Exact& b) {
    return {a.y * b.z + a.z * b.y, a.z * b.x + a.x * b.z, a.x * b.y + a.y * b.x};
}

struct Errors {
    long double t, u, v;
    bool other_side;  ///< `front` is wrong, and no rounding explains it
};

/// A ray against a triangle in exact arithmetic.
struct Crossing {
    Crossing(const Triangle& triangle, const Ray& ray)
        : a(triangle.v0),
          e1(Exact(triangle.v1) - a),
          e2(Exact(triangle.v2) - a),
          d(ray.direction),
          p(a - Exact(ray.origin)),
          n(cross(e1, e2)),
          r(cross(p, d)),
          facing(dot(n, d)),
          t(dot(n, p) / facing),
          u(dot(e2, r) / facing),
          v(-dot(e1, r) / facing) {}

    [[nodiscard]] bool is_inside() const { return u >= 0 && v >= 0 && u + v <= 1; }

    /// Returns the errors in units of 2^-24 times the terms of the bound in PROTOCOL.md: rounding of
    /// every product that t, u and v are made of, over n d.
    [[nodiscard]] Errors errors_of(const HitRecord& hit) const {
        const Exact n_size = cross_size(absolute(e1), absolute(e2));
        const Exact r_size = cross_size(absolute(p), absolute(d));
        const long double unit = 0x1p-24L / std::abs(facing);
        const long double d_size = dot(n_size, absolute(d));
        const long double t_unit = unit * (dot(n_size, absolute(p)) + std::abs(t) * d_size);
        const long double u_unit = unit * (dot(absolute(e2), r_size) + std::abs(u) * d_size);
        long double v_unit = unit * (dot(absolute(e1), r_size) + std::abs(v) * d_size);
        if (hit.v == 1 - hit.u)
            v_unit += u_unit;  // v is held to 1 - u, whose error it then has, too
        return {std::abs(hit.t - t) / t_unit, std::abs(hit.u - u) / u_unit,
                std::abs(hit.v - v) / v_unit,
                (hit.front == 1) != (facing < 0) && unit * d_size < 0.25L};
    }

    Exact a, e1, e2, d, p, n, r;
    long double facing, t, u, v;
};

/// Whether the hit's point is in the triangle's box, but for the rounding that PROTOCOL.md allows.
bool is_in_box(const HitRecord& hit, const Triangle& triangle, const Ray& ray) {
    float largest = 0;
    for (const Vec3& point : {ray.origin, triangle.v0, triangle.v1, triangle.v2})
        largest = std::max({largest, std::abs(point.x), std::abs(point.y), std::abs(point.z)});
    const long double slack = 0x1p-19L * largest;
    for (int axis = 0; axis < 3; ++axis) {
        const auto [lower, upper] =
            std::minmax({triangle.v0[axis], triangle.v1[axis], triangle.v2[axis]});
        const long double at =
            ray.origin[axis] + static_cast<long double>(hit.t) * ray.direction[axis];
        if (at < lower - slack || at > upper + slack) return false;
    }
    return true;
}

struct Target {
    float u, v;
};

/// Calls `visit` with the hits of rays to the targets that `target` chooses, on triangles of all sizes
/// and aspects.
template <class Choose, class Visit>
void visit_hits(const Choose& target_of, const Visit& visit) {
    std::mt19937 random(1);
    const auto uniform = [&](float from, float to) {
        return std::uniform_real_distribution<float>(from, to)(random);
    };
    for (const float length :
         {1e-15F, 1e-14F, 1e-10F, 1e-6F, 1e-3F, 1.0F, 1e3F, 1e4F, 1e6F, 1e9F, 1e15F}) {
        for (const float aspect : {1.0F, 1e-2F, 1e-4F, 1e-6F}) {
            // Products of two widths of a tiny sliver vanish in float32.
            const float width = length * aspect;
            if (width * length < 0.9e-30F) continue;
            for (int i = 0; i < 2000; ++i) {
                // A floor, a tilted floor, any sliver, or one that is met far from its corners by a
                // short ray across it; its long side is along any axis.
                const int kind = i % 4;
                const auto turn = [&, axis = i / 4 % 3](const Vec3& v) {
                    return axis == 0 ? v : axis == 1 ? Vec3(v.z, v.x, v.y) : Vec3(v.y, v.z, v.x);
                };
                const float rise = kind == 1 ? 0.3F : 0.0F;
                const auto point = [&](float x, float y, float z) {
                    return turn({width * x, width * y + rise * length * z, length * z});
                };
                const auto any = [&] {
                    return point(uniform(-1, 1), uniform(-1, 1), uniform(-1, 1));
                };
                Triangle triangle{point(-1, -1, 0), point(1, -1, 0), point(-1, -1, 1)};
                if (kind >= 2) triangle = {any(), any(), any()};
                const Target at = target_of(i / 12, uniform);
                const Vec3 target = triangle.v0 + at.u * (triangle.v1 - triangle.v0) +
                                    at.v * (triangle.v2 - triangle.v0);
                Vec3 origin = point(uniform(-1, 1), uniform(-0.8F, 2), uniform(-0.5F, 0.5F));
                if (kind == 3) {
                    const auto aside = [&] { return 3 * width * uniform(-1, 1); };
                    origin = target + Vec3(aside(), aside(), aside());
                }
                const Ray ray{origin, 0, (target - origin) / uniform(0.1F, 1) / length};
                const std::array one{triangle};
                const HitRecord hit = closest_hit(ray, one.begin(), one.end(), Opaque{});
                if (hit.hit == 1) visit(hit, triangle, ray);  // else the target itself is rounded
            }
        }
    }
}

/// The largest errors of hits, which must be within the stated bound.
struct Worst {
    void add(const Errors& errors) {
        ++hits;
        worst = {std::max(worst.t, errors.t), std::max(worst.u, errors.u),
                 std::max(worst.v, errors.v), worst.other_side || errors.other_side};
    }
    void check() const {
        constexpr long double bound = 4;
        CHECK(worst.t < bound);
        CHECK(worst.u < bound);
        CHECK(worst.v < bound);
        CHECK_FALSE(worst.other_side);
    }
    Errors worst{};
    int hits = 0;
};

}  // namespace

TEST_CASE("t, u and v are within the stated bound from 10^-15 m to 10^15 m and aspects of 10^-6") {
    Worst worst;
    visit_hits(
        [](int, const auto& uniform) {
            const float u = uniform(0.05F, 0.5F);
            return Target{u, uniform(0.05F, 0.4F)};
        },
        [&](const HitRecord& hit, const Triangle& triangle, const Ray& ray) {
            worst.add(Crossing(triangle, ray).errors_of(hit));
        });
    CHECK(worst.hits > 50'000);
    worst.check();
}

TEST_CASE(
    "on edges and corners the bound holds inside, and t stays in the triangle's box outside") {
    Worst worst;
    int outside = 0, astray = 0;
    visit_hits(
        [](int i, const auto& uniform) -> Target {
            const float along = uniform(0, 1);
            switch (i % 6) {
                case 0:
                    return {0, along};
                case 1:
                    return {along, 0};
                case 2:
                    return {along, 1 - along};
                case 3:
                    return {0, 0};
                case 4:
                    return {1, 0};
                default:
                    return {0, 1};
            }
        },
        [&](const HitRecord& hit, const Triangle& triangle, const Ray& ray) {
            CHECK((hit.u >= 0 && hit.v >= 0 && hit.u + hit.v <= 1));
            const Crossing exact(triangle, ray);
            if (exact.is_inside()) {
                worst.add(exact.errors_of(hit));
                return;
            }
            ++outside;
            if (!is_in_box(hit, triangle, ray)) ++astray;
        });
    CHECK(worst.hits > 10'000);
    CHECK(outside > 1'000);
    CHECK(astray == 0);
    worst.check();
}

TEST_CASE("the floor of a tunnel of 2 m x 10 km is where it is") {
    const std::array floor{Triangle{Vec3(-1, -1, 0), Vec3(1, -1, 0), Vec3(1, -1, 1e4F)},
                           Triangle{Vec3(-1, -1, 0), Vec3(1, -1, 1e4F), Vec3(-1, -1, 1e4F)}};
    const Ray ray{Vec3(-0.19429055F, -0.75589347F, 6947.584F), 0,
                  Vec3(0.34456325F, -0.09327114F, -0.93411815F)};
    const HitRecord hit = closest_hit(ray, floor.begin(), floor.end(), Opaque{});
    REQUIRE(hit.hit == 1);
    CHECK(hit.t == doctest::Approx(2.617171).epsilon(1e-6));
}

TEST_CASE("a triangle of 10^-14 m has its right distance") {
    const std::array tiny{Triangle{Vec3(-8.222131e-15F, -9.0405156e-15F, -2.4827662e-15F),
                                   Vec3(8.09848e-15F, 4.4204103e-16F, 7.25711e-15F),
                                   Vec3(-1e-15F, 8e-15F, 3e-15F)}};
    const Vec3 target = 0.4F * tiny[0].v0 + 0.3F * tiny[0].v1 + 0.3F * tiny[0].v2;
    const Vec3 direction(-0.58953869F, -0.66295582F, -0.46144739F);
    const Ray ray{target - 4e-14F * direction, 0, direction};
    const HitRecord hit = closest_hit(ray, tiny.begin(), tiny.end(), Opaque{});
    REQUIRE(hit.hit == 1);
    CHECK(hit.t == doctest::Approx(4e-14).epsilon(1e-5).scale(0));
}

TEST_CASE("1.8 m above a sphere of the Earth's size, t is right to a millimetre") {
    const std::array earth{Sphere{Vec3(0, -6'371'000, 0), 6'371'000}};
    const Ray down{Vec3(0, 1.8F, 0), 0, Vec3(0.6F, -0.8F, 0)};
    const HitRecord hit = closest_hit(down, earth.begin(), earth.end(), Opaque{});
    REQUIRE(hit.hit == 1);
    CHECK(hit.t == doctest::Approx(2.25).epsilon(1e-6));
}
