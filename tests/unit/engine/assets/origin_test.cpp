// Scenes far from zero: the digits that an origin keeps, and the warnings without one.
#include "engine/assets/builtin/builtin.h"
#include "engine/assets/import.h"
#include "tests/unit/engine/assets/samples.h"
#include "tests/unit/engine/builtin_packs.h"
#include "tests/unit/engine/small_scenes.h"

#include <cmath>
#include <limits>

using namespace raynest;
using test::registry;

namespace {

constexpr WorldPoint far{500'000, 4'500'000, 100};

std::shared_ptr<const Snapshot> load(const test::Upload& upload, const WorldPoint& origin,
                                     const std::string& primitive = {}) {
    ImportRequest request = upload.request();
    request.origin = origin;
    request.primitive = primitive;
    auto scene = import_here(request, ImportLimits{}, registry());
    if (!scene) throw std::runtime_error(scene.error().message);
    return *scene;
}

/// True if a warning of this scene states that an origin would help.
bool names_origin(const Snapshot& scene) {
    for (const std::string& warning : scene.statistics().warnings)
        if (warning.find("`origin` 500000,4500000,100") != std::string::npos) return true;
    return false;
}

/// Returns a mesh of one triangle at a node; both positions use the file's own numbers.
test::Upload triangle_at(const std::vector<float>& vertices, const std::string& node) {
    test::GlbWriter writer;
    const int position = writer.add_floats(vertices, "VEC3", 3);
    const std::string mesh =
        "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":" + std::to_string(position) +
        "}}]}]";
    return {"far.glb", writer.glb(mesh + ",\"nodes\":[{\"mesh\":0" + node + "}]")};
}

test::Bytes npy(const std::string& shape, const std::vector<double>& values) {
    std::string header = "{'descr': '<f8', 'fortran_order': False, 'shape': " + shape + ", }";
    while ((header.size() + 11) % 64 != 0) header += ' ';
    header += '\n';
    std::string file =
        std::string("\x93NUMPY\x01\0", 8) + static_cast<char>(header.size()) + '\0' + header;
    file.append(reinterpret_cast<const char*>(values.data()), values.size() * sizeof(double));
    return test::to_bytes(file);
}

}  // namespace

TEST_CASE("an origin is subtracted from placements before they are rounded") {
    const test::Upload upload = triangle_at(
        {0, 0, 0, 1, 0, 0, 0, 1, 0}, ",\"translation\":[500000.0078125,4500000.0078125,100]");
    const auto scene = load(upload, far);
    CHECK(scene->origin() == far);
    CHECK(scene->bounds().lower.x == doctest::Approx(0.0078125).epsilon(1e-6).scale(0));
    CHECK(scene->bounds().lower.y == doctest::Approx(0.0078125).epsilon(1e-6).scale(0));
    CHECK(scene->statistics().warnings.empty());

    const auto without = load(upload, {});
    CHECK(without->origin() == WorldPoint{});
    CHECK(names_origin(*without));
    CHECK(without->digest() != scene->digest());
}

TEST_CASE("the origin belongs to the content") {
    const test::Upload near = triangle_at({0, 0, 0, 1, 0, 0, 0, 1, 0}, "");
    const test::Upload shifted =
        triangle_at({0, 0, 0, 1, 0, 0, 0, 1, 0}, ",\"translation\":[500000,4500000,100]");
    const auto at_zero = load(near, {});
    const auto at_far = load(shifted, far);
    CHECK(at_zero->bounds().upper == at_far->bounds().upper);
    CHECK(at_zero->digest() != at_far->digest());
    CHECK(at_far->digest() == load(shifted, far)->digest());
    CHECK(load(near, {-0.0, -0.0, -0.0})->digest() == at_zero->digest());
}

TEST_CASE("a mesh with far vertices is moved to its centre, and its placements back") {
    // Quarters are exact in float32 up to 2^22 and halves up to 2^23.
    const test::Upload upload = triangle_at(
        {500'000.25F, 4'500'000, 100, 500'001.25F, 4'500'000, 100, 500'000.25F, 4'500'001, 100},
        "");
    const auto scene = load(upload, far);
    const SceneView& view = scene->view();
    CHECK(scene->bounds().lower.x == doctest::Approx(0.25));
    CHECK(scene->bounds().upper.y == doctest::Approx(1));
    REQUIRE(view.instance_count == 1);
    for (const float x : view.instance_infos[0].to_parent.m) CHECK(std::abs(x) <= 2);
    const Vec3* positions = view.attribute<Vec3>(view.geometries[0].positions);
    for (int i = 0; i < 3; ++i) CHECK(glm::length(positions[i]) <= 1);

    // Without an origin the file is used as it is: float32 moves none of it.
    const auto without = load(upload, {});
    const SceneView& as_it_is = without->view();
    CHECK(as_it_is.attribute<Vec3>(as_it_is.geometries[0].positions)[0].x == 500'000.25F);
    CHECK_FALSE(names_origin(*without));
}

TEST_CASE("cameras are in the scene's coordinates") {
    test::GlbWriter writer;
    const std::string mesh = test::one_triangle_mesh(writer);
    const test::Upload upload(
        "camera.glb", writer.glb(mesh + ",\"cameras\":[{\"type\":\"perspective\",\"perspective\":"
                                        "{\"yfov\":1,\"znear\":0.1}}],\"nodes\":[{\"translation\":"
                                        "[500000,4500000,100],\"children\":[1,2]},{\"mesh\":0},"
                                        "{\"camera\":0,\"translation\":[0.25,0,5]}]"));
    const auto scene = load(upload, far);
    REQUIRE(scene->view().camera_count == 1);
    const auto& pose = scene->view().cameras[0].to_world.m;
    CHECK(pose[3] == 0.25F);
    CHECK(pose[7] == 0);
    CHECK(pose[11] == 5);
}

TEST_CASE("records and their placements have the origin subtracted in double") {
    const auto spheres = npy("(1, 4)", {500'000.015625, 4'500'000.015625, 100, 0.0625});
    const auto scene = load({"points.npy", spheres}, far, "sphere");
    CHECK(scene->origin() == far);
    CHECK(scene->bounds().lower.x == doctest::Approx(0.015625 - 0.0625));
    CHECK(scene->bounds().upper.y == doctest::Approx(0.015625 + 0.0625));
    CHECK(scene->statistics().warnings.empty());
    CHECK(names_origin(*load({"points.npy", spheres}, {}, "sphere")));

    test::Upload placed("points.npy", npy("(1, 4)", {0, 0, 0, 1}));
    placed.add("instances.npy", npy("(1, 12)", {1, 0, 0, 500'000.015625, 0, 1, 0, 4'500'000,  //
                                                0, 0, 1, 100}));
    const auto instances = load(placed, far, "sphere");
    CHECK(instances->bounds().upper.x == doctest::Approx(1.015625));
    CHECK(instances->bounds().lower.z == doctest::Approx(-1));
}

TEST_CASE("an invalid origin is refused, and so is one for a built-in scene") {
    const test::Upload upload = triangle_at({0, 0, 0, 1, 0, 0, 0, 1, 0}, "");
    for (const double bad : {std::numeric_limits<double>::infinity(), 1e16, std::nan("")})
        CHECK_THROWS_WITH(load(upload, {0, bad, 0}),
                          "far.glb: the origin is not finite, or lies beyond 1e15");
    ImportRequest request;
    request.source = "builtin:flake";
    request.origin = far;
    CHECK_FALSE(import_here(request, ImportLimits{}, registry(), describe_builtin).has_value());
}

TEST_CASE("triangles that no ray can hit are counted, also in the total") {
    SceneDescription scene;
    scene.objects.resize(1);
    GeometryDescription square = test::unit_square();
    square.positions.insert(square.positions.end(),
                            {{2, 2, 2}, {1e-24F, 0, 0}, {0, 1e-24F, 0}, {0, 0, 0}, {3, 3, 3}});
    // A point, a triangle that is too small, and one whose corners lie on a line.
    square.indices.insert(square.indices.end(), {4, 4, 0, 5, 6, 7, 0, 4, 8});
    square.texcoords[0].clear();
    scene.objects[0].geometries = {square};
    const auto snapshot = test::build_scene(scene);
    CHECK(snapshot->statistics().degenerate_triangles == 3);
    CHECK(snapshot->statistics().unique_triangles == 5);
}
