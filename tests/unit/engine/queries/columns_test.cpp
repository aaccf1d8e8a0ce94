#include "engine/queries/columns.h"

#include "engine/packs/registry.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <cmath>
#include <cstring>
#include <limits>
#include <vector>

using namespace raynest;
using test::place;
using test::rotation;
using test::scaling;
using test::translation;

namespace {

template <class T>
std::vector<T> column(const Column& field, const ColumnSource& source, std::size_t rows) {
    REQUIRE(field_bytes(field.field) == sizeof(T));
    std::vector<T> values(rows + 1);
    std::memset(values.data(), 0x5A, values.size() * sizeof(T));
    const T guard = values.back();
    write_column(field, source, reinterpret_cast<std::byte*>(values.data()));
    CHECK(std::memcmp(&values.back(), &guard, sizeof(T)) == 0);  // no byte too many
    values.pop_back();
    return values;
}

HitRecord hit_at(const SceneView& scene, std::uint64_t path, std::uint32_t triangle, float t) {
    HitRecord hit;
    hit.hit = 1;
    hit.t = t;
    hit.u = 0.25F;
    hit.v = 0.5F;
    hit.triangle = triangle;
    hit.path = path;
    const ObjectRecord* const object = walk_path(scene, path, [](std::uint32_t) {});
    REQUIRE(object != nullptr);
    hit.object = static_cast<std::uint32_t>(object - scene.objects);
    hit.front = 1;
    return hit;
}

/// Returns a square placed once by `transform`.
std::shared_ptr<const Snapshot> placed_square(const Transform& transform) {
    SceneDescription scene;
    scene.objects.resize(2);
    scene.objects[0].instances = {place(1, transform)};
    scene.objects[1].geometries = {test::unit_square()};
    return test::build_scene(scene);
}

}  // namespace

TEST_CASE("names and columns match the table of PROTOCOL.md") {
    CHECK(parse_field("t") == Field::t);
    CHECK(parse_field("total") == Field::total);
    for (std::uint32_t i = 0; i < static_cast<std::uint32_t>(Field::count_); ++i) {
        const auto field = static_cast<Field>(i);
        CHECK(parse_field(field_info(field).name) == field);
    }
    CHECK(field_bytes(Field::hit) == 1);
    CHECK(field_bytes(Field::path) == 8);
    CHECK(field_bytes(Field::uv) == 8);
    CHECK(field_bytes(Field::ng) == 12);
    CHECK_FALSE(field_info(Field::instances).width != 1);
    CHECK(field_info(Field::total).counter);
    CHECK_FALSE(field_info(Field::inst).counter);
    const auto unknown = parse_field("depth");
    REQUIRE_FALSE(unknown.has_value());
    CHECK(unknown.error().code == ErrorCode::field_invalid);
    CHECK(unknown.error().message.find("position") != std::string::npos);
}

TEST_CASE("a miss is canonical in every column") {
    const auto scene = test::build_scene(test::tree_scene());
    const std::vector<Ray> rays(2);
    std::vector<HitRecord> misses(2);
    misses[1].flags = hit_invalid_ray;
    const ColumnSource source{&scene->view(), rays, misses};
    CHECK(column<std::uint8_t>(Field::hit, source, 2)[0] == 0);
    CHECK(column<float>(Field::t, source, 2)[0] == std::numeric_limits<float>::infinity());
    for (const Field id : {Field::prim, Field::geom, Field::inst, Field::uid, Field::material}) {
        CHECK(column<std::uint32_t>(id, source, 2)[1] == 0xFFFFFFFFU);
    }
    CHECK(column<std::uint64_t>(Field::path, source, 2)[0] == no_path);
    CHECK(column<Vec2>(Field::uv, source, 2)[0] == Vec2(0));
    CHECK(column<Vec3>(Field::ng, source, 2)[0] == Vec3(0));
    CHECK(column<Vec3>(Field::position, source, 2)[0] == Vec3(0));
    CHECK(column<std::uint8_t>(Field::front, source, 2)[0] == 0);
    CHECK(column<std::uint8_t>(Field::flags, source, 2) == std::vector<std::uint8_t>{0, 1});
}

TEST_CASE("hits name geometry, primitive, instance and user id") {
    SceneDescription description = test::tree_scene();
    description.materials.resize(3);
    description.objects[0].geometries = {test::unit_square(2), test::unit_square(),
                                         test::unit_square(1)};
    const auto scene = test::build_scene(description);
    const SceneView& view = scene->view();
    const std::vector<Ray> rays(3);
    // Third twig, second leaf, second triangle of the third square; then the lone leaf; then a
    // twig.
    const std::vector<HitRecord> hits{hit_at(view, 9, 5, 1), hit_at(view, 6, 2, 2),
                                      hit_at(view, 3, 1, 3)};
    const ColumnSource source{&view, rays, hits};
    using U32 = std::vector<std::uint32_t>;
    CHECK(column<std::uint32_t>(Field::geom, source, 3) == U32{2, 1, 0});
    CHECK(column<std::uint32_t>(Field::prim, source, 3) == U32{1, 0, 1});
    CHECK(column<std::uint32_t>(Field::inst, source, 3) == U32{3, 2, 1});
    CHECK(column<std::uint32_t>(Field::uid, source, 3) == U32{12, 3, 2});
    CHECK(column<std::uint32_t>(Field::material, source, 3) == U32{1, no_id, no_id});
    CHECK(column<std::uint64_t>(Field::path, source, 3) == std::vector<std::uint64_t>{9, 6, 3});
    CHECK(column<float>(Field::t, source, 3) == std::vector<float>{1, 2, 3});
    CHECK(column<Vec2>(Field::uv, source, 3)[0] == Vec2(0.25F, 0.5F));
}

TEST_CASE("primitives of the root have no instance") {
    SceneDescription description;
    description.objects.resize(1);
    description.objects[0].geometries = {test::unit_square()};
    const auto scene = test::build_scene(description);
    const std::vector<Ray> rays(1);
    const std::vector<HitRecord> hits{hit_at(scene->view(), 0, 0, 1)};
    const ColumnSource source{&scene->view(), rays, hits};
    CHECK(column<std::uint32_t>(Field::inst, source, 1)[0] == no_id);
    CHECK(column<std::uint32_t>(Field::uid, source, 1)[0] == no_id);
    CHECK(column<Vec3>(Field::ng, source, 1)[0] == Vec3(0, 0, 1));
}

TEST_CASE("positions lie on the ray of their hit, also in compacted multi-hit answers") {
    const auto scene = test::build_scene(test::tree_scene());
    std::vector<Ray> rays(2);
    rays[0].direction = {0, 0, -2};
    rays[1].origin = {1, 2, 3};
    rays[1].direction = {0, 1, 0};
    const std::vector<HitRecord> hits{hit_at(scene->view(), 0, 0, 5),
                                      hit_at(scene->view(), 1, 0, 1),
                                      hit_at(scene->view(), 2, 0, 4)};
    const std::vector<std::uint32_t> ray_of{0, 1, 1};
    const ColumnSource source{&scene->view(), rays, hits, ray_of};
    const auto positions = column<Vec3>(Field::position, source, 3);
    CHECK(positions[0] == Vec3(0, 0, -10));
    CHECK(positions[1] == Vec3(1, 3, 3));
    CHECK(positions[2] == Vec3(1, 6, 3));
}

TEST_CASE("normals are unit length and outward under rotation, stretching and mirroring") {
    const auto normal_under = [](const Transform& transform) {
        const auto scene = placed_square(transform);
        const std::vector<Ray> rays(1);
        const std::vector<HitRecord> hits{hit_at(scene->view(), 0, 0, 1)};
        return column<Vec3>(Field::ng, {&scene->view(), rays, hits}, 1)[0];
    };
    const auto is_close = [](const Vec3& a, const Vec3& b) { return glm::length(a - b) < 1e-6F; };
    CHECK(is_close(normal_under(rotation(1)), {std::sin(1.0F), 0, std::cos(1.0F)}));
    CHECK(is_close(normal_under(scaling(3, 5, 1e-12F)), {0, 0, 1}));
    CHECK(is_close(normal_under(scaling(-1, 1, 1)), {0, 0, 1}));  // winding flips, outside does not
    CHECK(is_close(normal_under(scaling(1, 1, -1)), {0, 0, -1}));  // outside itself is mirrored
    // A shear along z of x: the plane tilts, and its normal stays perpendicular to it.
    const Transform shear{{1, 0, 0, 0, 0, 1, 0, 0, 2, 0, 1, 0}};
    CHECK(is_close(normal_under(shear), glm::normalize(Vec3(-2, 0, 1))));
}

TEST_CASE("surfaces have the normals, texture coordinates and colours of their vertices") {
    SceneDescription description;
    description.objects.resize(2);
    GeometryDescription square = test::unit_square(0);
    square.normals = {{0, 0, 2}, {0, 0, 1}, {0, 3, 0}, {0, 0, 1}};
    square.texcoords[1] = {{0, 0}, {4, 0}, {4, 8}, {0, 8}};
    square.colours = {255, 0, 0, 255, 255, 0, 0, 255, 255, 255, 0, 255, 255, 0, 0, 255};
    description.materials.resize(1);
    description.materials[0].texcoord = 1;
    description.materials[0].base_colour = Vec4(0.5F, 1, 1, 1);
    GeometryDescription bare = test::unit_square();
    bare.texcoords[0].clear();
    description.objects[0].geometries = {square, bare};
    description.objects[1].instances = {test::place(0, scaling(1, 1, 2), "stretched")};
    description.root = 1;
    const auto scene = test::build_scene(description);
    const std::vector<Ray> rays(3);
    std::vector<HitRecord> hits{hit_at(scene->view(), 0, 0, 1), hit_at(scene->view(), 0, 2, 1), {}};
    hits[0].u = 0.25F;  // weight of corner 1; corner 2 has half
    hits[0].v = 0.5F;
    ColumnSource source{&scene->view(), rays, hits};
    source.shading = scene->shading().geometries;
    // (0, 1.5, 0.75) in the object; a normal shrinks where the placement stretches.
    const auto normals = column<Vec3>(Field::normal, source, 3);
    CHECK(glm::length(normals[0] - glm::normalize(Vec3(0, 1.5F, 0.375F))) < 1e-6F);
    CHECK(normals[1] == Vec3(0, 0, 1));  // no vertex normals: ng
    CHECK(normals[2] == Vec3(0));
    const auto texcoords = column<Vec2>(Field::texcoord, source, 3);
    CHECK(texcoords[0] == Vec2(3, 4));
    CHECK(texcoords[1] == Vec2(0));
    const auto colours = column<Vec3>(Field::base_colour, source, 3);
    CHECK(colours[0] == Vec3(0.5F, 0.5F, 0));
    CHECK(colours[1] == Vec3(1));
    CHECK(colours[2] == Vec3(0));
}

TEST_CASE("front is set if the ray meets the side that the normal points to, also mirrored") {
    const auto registry = Registry::load({});
    REQUIRE(registry.has_value());
    const auto closest =
        find_function(*(*registry)->find("opaque"), query_closest, traversal_single);
    REQUIRE(closest.has_value());
    for (const Transform& transform :
         {scaling(1, 1, 1), scaling(-1, 1, 1), scaling(1, 1, -1), scaling(-1, -2, -3)}) {
        const auto scene = placed_square(transform);
        std::vector<Ray> rays(2);
        for (std::size_t i = 0; i < 2; ++i) {
            const float z = i == 0 ? 1.0F : -1.0F;
            rays[i].origin = transform.point({0.5F, 0.25F, 0}) + Vec3(0, 0, z);
            rays[i].direction = {0, 0, -z};
        }
        std::vector<HitRecord> hits(2);
        TraceCall call{};
        call.scene = &scene->view();
        call.rays = rays.data();
        call.ray_count = 2;
        call.hits_max = 1;
        call.mask = 0xFFFFFFFFU;
        call.hits = hits.data();
        REQUIRE((*closest)(&call) == trace_ok);
        const ColumnSource source{&scene->view(), rays, hits};
        CHECK(column<std::uint8_t>(Field::hit, source, 2) == std::vector<std::uint8_t>{1, 1});
        const auto normals = column<Vec3>(Field::ng, source, 2);
        const auto front = column<std::uint8_t>(Field::front, source, 2);
        for (std::size_t i = 0; i < 2; ++i) {
            CHECK(normals[0] == normals[i]);
            CHECK((front[i] == 1) == (glm::dot(normals[i], rays[i].direction) < 0));
        }
    }
}

TEST_CASE("normals of tiny triangles do not vanish") {
    SceneDescription description;
    description.objects.resize(1);
    GeometryDescription square = test::unit_square();
    for (Vec3& p : square.positions) p *= 1e-30F;
    description.objects[0].geometries = {square};
    const auto scene = test::build_scene(description);
    const std::vector<Ray> rays(1);
    const std::vector<HitRecord> hits{hit_at(scene->view(), 0, 1, 1)};
    CHECK(column<Vec3>(Field::ng, {&scene->view(), rays, hits}, 1)[0] == Vec3(0, 0, 1));
}

TEST_CASE("records have their own normal, index and no texture coordinates") {
    SceneDescription description;
    description.objects.resize(2);
    description.objects[0].instances = {place(1, scaling(2, 2, -2))};
    ObjectDescription& object = description.objects[1];
    object.record_type = "arrow";
    for (int i = 0; i < 30; ++i) {  // each record holds its own normal
        const float normal[3] = {static_cast<float>(i), 0, 1};
        const auto* bytes = reinterpret_cast<const std::byte*>(normal);
        object.records.insert(object.records.end(), bytes, bytes + sizeof normal);
        object.record_bounds.push_back(
            {Vec3(static_cast<float>(-i)), Vec3(static_cast<float>(1 - i))});
    }
    const auto scene = test::build_scene(description);
    const std::vector<Ray> rays(1);
    const std::vector<HitRecord> hits{hit_at(scene->view(), 0, 7, 1)};
    ColumnSource source{&scene->view(), rays, hits};
    CHECK(column<Vec3>(Field::ng, source, 1)[0] == Vec3(0));  // unknown type
    source.record_normal = [](std::uint32_t type, const void*) -> RecordNormal {
        if (type != primitive_type("arrow")) return nullptr;
        return [](const void* record, const float*, float normal[3]) noexcept {
            std::memcpy(normal, record, 3 * sizeof(float));
        };
    };
    const Vec3 normal = column<Vec3>(Field::ng, source, 1)[0];
    CHECK(glm::length(normal - glm::normalize(Vec3(7, 0, -1))) < 1e-6F);
    CHECK(column<std::uint32_t>(Field::prim, source, 1)[0] == 7);
    CHECK(column<std::uint32_t>(Field::geom, source, 1)[0] == 0);
    CHECK(column<Vec2>(Field::uv, source, 1)[0] == Vec2(0));
    CHECK(column<std::uint32_t>(Field::material, source, 1)[0] == no_id);
}

TEST_CASE("a counter of one level is a column, and the levels add up to the total") {
    const auto scene = test::build_scene(test::tree_scene());
    const std::vector<Ray> rays(2);
    const std::vector<HitRecord> hits(2);
    const std::vector<Counters> counters{{1, 8, 2, 11, 3, 1, 4, 5, 6},
                                         {10, 20, 30, 40, 50, 2, 60, 70, 80},
                                         {2, 3, 4, 5, 6, 3, 7, 8, 9},
                                         {}};
    ColumnSource source{&scene->view(), rays, hits};
    source.counters = counters;
    source.counter_sets = 2;
    using U32 = std::vector<std::uint32_t>;
    CHECK(column<std::uint32_t>({Field::boxes, 0}, source, 2) == U32{8, 3});
    CHECK(column<std::uint32_t>({Field::boxes, 1}, source, 2) == U32{20, 0});
    CHECK(column<std::uint32_t>(Field::boxes, source, 2) == U32{28, 3});
    CHECK(column<std::uint32_t>(Field::prim_hits, source, 2) == U32{86, 9});
    CHECK(column<std::uint32_t>({Field::total, 1}, source, 2) == U32{60, 0});
    CHECK(column<std::uint32_t>(Field::total, source, 2) == U32{79, 8});
}

TEST_CASE("columns of a level are counters with a number behind a dot") {
    CHECK(parse_column("boxes") == Column(Field::boxes));
    CHECK(parse_column("boxes.0") == Column(Field::boxes, 0));
    CHECK(parse_column("prim_hits.31") == Column(Field::prim_hits, 31));
    CHECK(column_name({Field::total, 3}) == "total.3");
    CHECK(column_name(Field::t) == "t");
    for (const char* wrong : {"boxes.", "boxes.x", "boxes.-1", "boxes.01", "boxes.4294967295",
                              "boxes.1.0", "boxes. 1", "t.0", ".0", "boxes.4294967296"}) {
        CAPTURE(wrong);
        const auto refused = parse_column(wrong);
        REQUIRE_FALSE(refused);
        CHECK(refused.error().code == ErrorCode::field_invalid);
    }
    CHECK(check_level({Field::boxes, 1}, 2));
    CHECK(check_level(Field::boxes, 1));
    const auto deep = check_level({Field::boxes, 2}, 2);
    REQUIRE_FALSE(deep);
    CHECK(deep.error().message == "there is no column 'boxes.2': the scene has 2 levels, 0 to 1");
}

TEST_CASE("counters are one per ray and total is boxes plus primitives") {
    const auto scene = test::build_scene(test::tree_scene());
    const std::vector<Ray> rays(2);
    const std::vector<HitRecord> hits(2);
    const std::vector<Counters> counters{{1, 8, 2, 11, 3, 1, 4}, {5, 6, 7, 8, 9, 2, 10}};
    ColumnSource source{&scene->view(), rays, hits};
    source.counters = counters;
    using U32 = std::vector<std::uint32_t>;
    CHECK(column<std::uint32_t>(Field::nodes, source, 2) == U32{1, 5});
    CHECK(column<std::uint32_t>(Field::boxes, source, 2) == U32{8, 6});
    CHECK(column<std::uint32_t>(Field::leaves, source, 2) == U32{2, 7});
    CHECK(column<std::uint32_t>(Field::prims, source, 2) == U32{11, 8});
    CHECK(column<std::uint32_t>(Field::instances, source, 2) == U32{3, 9});
    CHECK(column<std::uint32_t>(Field::instance_misses, source, 2) == U32{1, 2});
    CHECK(column<std::uint32_t>(Field::rejects, source, 2) == U32{4, 10});
    CHECK(column<std::uint32_t>(Field::total, source, 2) == U32{19, 14});
}

TEST_CASE(
    "an order gives the hit and ray of each element, and rays are given back for misses too") {
    const auto scene = test::build_scene(test::tree_scene());
    std::vector<Ray> rays(3);
    std::vector<HitRecord> hits(3);
    for (std::size_t i = 0; i < 3; ++i) {
        rays[i].origin.x = static_cast<float>(i);
        rays[i].direction.y = static_cast<float>(10 * i);
        hits[i].flags = static_cast<std::uint8_t>(i);
    }
    hits[1].hit = 1;
    hits[1].t = 5;
    const std::vector<std::uint32_t> order{2, 1};
    ColumnSource source{&scene->view(), rays, hits};
    source.order = order;
    constexpr float none = std::numeric_limits<float>::infinity();
    CHECK(column<float>(Field::t, source, 2) == std::vector<float>{none, 5});
    CHECK(column<std::uint8_t>(Field::flags, source, 2) == std::vector<std::uint8_t>{2, 1});
    CHECK(column<Vec3>(Field::origin, source, 2)[0] == Vec3(2, 0, 0));
    CHECK(column<Vec3>(Field::direction, source, 2)[1] == Vec3(0, 10, 0));
}

TEST_CASE("a path gives the transform from the world to its object") {
    const auto scene = test::build_scene(test::tree_scene());
    // Second twig at x = 10, second leaf at y = 4.
    CHECK(world_to_object(scene->view(), 5).point({10, 4, 0}) == Vec3(0, 0, 0));
}
