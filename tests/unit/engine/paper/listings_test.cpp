// The listings of "Adding Custom Intersectors to the C++ Ray Tracing Template Library Visionaray"
// (Zellmann, 2019), in the same shape, on this engine: a custom primitive with intersect(), a
// custom intersector, the queries with and without it, the alpha texture and bvh_costs.
//
// Differences from the paper: no CRTP base and no `using operator()` (the traversal calls the
// intersector, nothing is derived), and `hr.keep_if(...)` in place of `hr.hit &= ...`, because a
// hit may have several lanes.
#include "engine/geometry/record.h"
#include "engine/queries/range.h"
#include "engine/scene/snapshot.h"

#include <doctest/doctest.h>

#include <array>
#include <memory>
#include <vector>

namespace paper {

using namespace raynest;

// "A custom primitive can be added by implementing a set of free functions."
struct CustomPrimitive {  // a disc that faces +z
    float x, y, z, radius;
};

Box bounds(const CustomPrimitive& d) {
    return {{d.x - d.radius, d.y - d.radius, d.z}, {d.x + d.radius, d.y + d.radius, d.z}};
}

template <class Ray>
auto intersect(const Ray& ray, const CustomPrimitive& d) {
    auto hr = no_hits<1>(d);
    if (ray.direction.z == 0) return hr;
    const float t = (d.z - ray.origin.z) / ray.direction.z;
    const Vec3 p = ray.at(t);
    const float dx = p.x - d.x;
    const float dy = p.y - d.y;
    if (dx * dx + dy * dy <= d.radius * d.radius) {
        add_hit(hr, 0, t, dx / d.radius, dy / d.radius, ray.direction.z < 0);
    }
    return hr;
}

// "The user then implements her own operator() as a member function, with the signature of the
// intersect function": manipulates the hit record, then returns it.
struct CustomIntersector {
    auto operator()(const auto& ray, const RecordLike auto& prim) {
        auto hr = intersect(ray, prim);
        hr.keep_if([](const Surface& hit) { return hit.u >= 0; });
        return hr;
    }
};

// "A custom intersector which stores a pointer to the texture and texture coordinate lists."
struct AlphaIntersector {
    const std::vector<std::array<std::array<float, 4>, 4>>& textures;  // 2 x 2 texels each
    const std::vector<Vec2>& tex_coords;                               // three per triangle

    auto operator()(const auto& ray, const TriangleLike auto& tri) {
        auto hr = intersect(ray, tri);
        hr.keep_if([&](const Surface& hit) {
            const auto& tex = textures[hit.geom];
            const Vec2* st = &tex_coords[hit.prim * 3U];
            const Vec2 coord = (1 - hit.u - hit.v) * st[0] + hit.u * st[1] + hit.v * st[2];
            const auto& color = tex[(coord.y < 0.5F ? 0U : 2U) + (coord.x < 0.5F ? 0U : 1U)];
            return color[3] >= .01F;
        });
        return hr;
    }
};

// "A custom intersector is implemented that just counts the number of interactions."
struct BvhCosts {
    auto operator()(const auto& ray, const BoxLike auto& box) {
        num_boxes += static_cast<unsigned>(std::popcount(box.valid()));
        return intersect(ray, box);
    }
    auto operator()(const auto& ray, const TriangleLike auto& tri) {
        num_tris += 1;
        return intersect(ray, tri);
    }
    unsigned num_boxes = 0;
    unsigned num_tris = 0;
};

// Acts in object space inside instances: refuses the upper quad.
struct LowerQuad {
    int asked = 0;
    auto operator()(const auto& ray, const TriangleLike auto& tri) {
        ++asked;
        auto hr = intersect(ray, tri);
        hr.keep_if([&](const Surface& hit) { return ray.at(hit.t).z < -0.5F; });
        return hr;
    }
};

// A quad in the plane z: two triangles whose texture coordinates are the corners of a picture.
std::vector<Triangle> quad(float z, std::uint32_t geom, std::uint32_t first_prim) {
    const Vec3 a(0, 0, z);
    const Vec3 b(1, 0, z);
    const Vec3 c(1, 1, z);
    const Vec3 d(0, 1, z);
    return {{a, b, c, first_prim, geom}, {a, c, d, first_prim + 1, geom}};
}

const std::vector<Vec2> quad_coords{{0, 0}, {1, 0}, {1, 1}, {0, 0}, {1, 1}, {0, 1},
                                    {0, 0}, {1, 0}, {1, 1}, {0, 0}, {1, 1}, {0, 1}};

Ray towards(float x, float y) {
    Ray ray;
    ray.origin = {x, y, 2};
    ray.direction = {0, 0, -1};
    return ray;
}

// Returns quads at z = 0, -1, ... Each level lifts by 1/8, each further copy by another 1/8.
std::shared_ptr<const Snapshot> quads_under_instances(int levels, int copies = 1, int quads = 2) {
    SceneDescription scene;
    ObjectDescription mesh;
    GeometryDescription geometry;
    for (int i = 0; i < quads; ++i) {
        for (const Triangle& t : quad(static_cast<float>(-i), 0, 0)) {
            for (const Vec3& v : {t.v0, t.v1, t.v2}) {
                geometry.indices.push_back(static_cast<std::uint32_t>(geometry.positions.size()));
                geometry.positions.push_back(v);
            }
        }
    }
    mesh.geometries.push_back(geometry);
    scene.objects.push_back(mesh);
    for (int level = 0; level < levels; ++level) {
        ObjectDescription outer;
        InstanceDescription instance;
        instance.object = static_cast<std::uint32_t>(level);
        for (int copy = 0; copy < copies; ++copy) {
            instance.transform.m[11] += 0.125F;
            outer.instances.push_back(instance);
        }
        scene.objects.push_back(outer);
    }
    scene.root = static_cast<std::uint32_t>(levels);
    auto snapshot = Snapshot::build(scene);
    REQUIRE_MESSAGE(snapshot.has_value(), (snapshot ? "" : snapshot.error().message));
    return *snapshot;
}

}  // namespace paper

using namespace paper;

TEST_CASE("a custom primitive needs intersect() and bounds() only, and works in a plain list") {
    const std::vector<CustomPrimitive> discs{{0, 0, 0, 1}, {0, 0, 1, 0.5F}};
    const HitRecord near = closest_hit(towards(0.25F, 0.25F), discs.begin(), discs.end());
    CHECK(near.hit == 1);
    CHECK(near.t == doctest::Approx(1));
    CHECK(near.path == 1);  // the second disc
    const HitRecord behind = closest_hit(towards(0.75F, 0), discs.begin(), discs.end());
    CHECK(behind.path == 0);
    CHECK_FALSE(any_hit(towards(2, 2), discs.begin(), discs.end()));
}

TEST_CASE("a custom intersector replaces intersect() of a custom primitive in a plain list") {
    const std::vector<CustomPrimitive> discs{{0, 0, 0, 1}, {0, 0, 1, 0.5F}};
    CHECK(closest_hit(towards(-0.25F, 0), discs.begin(), discs.end()).hit == 1);
    CHECK(closest_hit(towards(-0.25F, 0), discs.begin(), discs.end(), CustomIntersector{}).hit ==
          0);
    CHECK(any_hit(towards(0.25F, 0), discs.begin(), discs.end(), CustomIntersector{}));
    CHECK(multi_hit<4>(towards(0.25F, 0), discs.begin(), discs.end(), CustomIntersector{}).count ==
          2);
}

TEST_CASE("an alpha texture lets the ray through to the quad behind") {
    std::vector<Triangle> list = quad(0, 0, 0);
    for (const Triangle& t : quad(-1, 1, 2)) list.push_back(t);
    // Texture 0 has one opaque corner, texture 1 is opaque.
    const std::array<float, 4> solid{1, 1, 1, 1};
    const std::array<float, 4> hole{1, 1, 1, 0};
    const std::vector<std::array<std::array<float, 4>, 4>> textures{{solid, hole, hole, hole},
                                                                    {solid, solid, solid, solid}};
    AlphaIntersector alpha{textures, quad_coords};

    CHECK(closest_hit(towards(0.75F, 0.7F), list.begin(), list.end()).t == doctest::Approx(2));
    CHECK(closest_hit(towards(0.75F, 0.7F), list.begin(), list.end(), alpha).t ==
          doctest::Approx(3));
    CHECK(closest_hit(towards(0.2F, 0.3F), list.begin(), list.end(), alpha).t ==
          doctest::Approx(2));
    const auto hits = multi_hit<2>(towards(0.2F, 0.3F), list.begin(), list.end(), alpha);
    CHECK(hits.count == 2);
    CHECK(hits.hits[0].t < hits.hits[1].t);
    CHECK(multi_hit<2>(towards(0.75F, 0.7F), list.begin(), list.end(), alpha).count == 1);
}

TEST_CASE("bvh_costs counts boxes in a list of BVHs, which a list of triangles lacks") {
    BvhCosts linear;
    const std::vector<Triangle> list = quad(0, 0, 0);
    CHECK(closest_hit(towards(0.3F, 0.2F), list.begin(), list.end(), linear).hit == 1);
    CHECK(linear.num_boxes == 0);  // no BVH, no box
    CHECK(linear.num_tris == 2);

    // The same intersector works in nested BVHs of any depth.
    for (const int levels : {0, 1, 2, 3}) {
        const auto scene = quads_under_instances(levels, 1, 20);  // more than a leaf holds
        const std::vector<Bvh> roots{{&scene->view(), scene->view().root}};
        BvhCosts costs;
        const HitRecord hit = closest_hit(towards(0.3F, 0.2F), roots.begin(), roots.end(), costs);
        CHECK(hit.t == doctest::Approx(2 - 0.125 * levels));
        CHECK(costs.num_tris >= 1);
        CHECK(costs.num_boxes > 0);
    }
}

TEST_CASE("an intersector passes through three nested instances") {
    const auto scene = quads_under_instances(3);
    const std::vector<Bvh> roots{{&scene->view(), scene->view().root}};
    LowerQuad lower;
    const HitRecord hit = closest_hit(towards(0.3F, 0.2F), roots.begin(), roots.end(), lower);
    CHECK(hit.t == doctest::Approx(3 - 0.375));
    CHECK(lower.asked > 0);
    CHECK(any_hit(towards(0.3F, 0.2F), roots.begin(), roots.end(), lower));
    CHECK(multi_hit<4>(towards(0.3F, 0.2F), roots.begin(), roots.end(), lower).count == 1);
}

TEST_CASE(
    "several roots share one shrinking distance and number their placements one after another") {
    const auto scene = quads_under_instances(1);
    const std::vector<Bvh> roots{{&scene->view(), 0}, {&scene->view(), scene->view().root}};
    const HitRecord hit = closest_hit(towards(0.3F, 0.2F), roots.begin(), roots.end());
    CHECK(hit.t == doctest::Approx(1.875));  // the lifted copy is nearer
    CHECK(hit.path == 1);                    // first placement of the second root
    const auto all = multi_hit<8>(towards(0.3F, 0.2F), roots.begin(), roots.end());
    CHECK(all.count == 4);
    CHECK(all.hits[0].path == 1);
    CHECK(all.hits[1].path == 0);
}

TEST_CASE("instances in a list count from where the list begins") {
    const auto scene = quads_under_instances(1, 2);
    const Instance low{&scene->view(), 0};
    const Instance high{&scene->view(), 1};
    const auto path_of = [](const std::vector<Instance>& list) {
        return closest_hit(towards(0.3F, 0.2F), list.begin(), list.end()).path;
    };
    CHECK(path_of({high}) == 0);
    CHECK(path_of({low, high}) == 1);
    CHECK(path_of({high, low}) == 0);
}
