// Normals and tangents of skinned and morphed meshes, and normals that point against their faces.
#include "engine/scene/snapshot.h"
#include "tests/unit/engine/assets/describe.h"

#include <cmath>
#include <limits>
#include <numbers>

using namespace raynest;
using test::contains;
using test::GlbWriter;
using test::must_describe;

namespace {

/// A sphere with a seam: the first and the last column have the same places and normals, and the
/// normals point outward.
class Sphere {
public:
    static constexpr std::uint16_t rows = 10, columns = 20;

    explicit Sphere(float side = 1) {
        std::vector<float> tangents;
        for (int row = 0; row <= rows; ++row) {
            for (int column = 0; column <= columns; ++column) {
                const double polar = std::numbers::pi * row / rows;
                const double around = 2 * std::numbers::pi * column / columns;
                const Vec3 n(glm::dvec3(std::sin(polar) * std::cos(around), std::cos(polar),
                                        -std::sin(polar) * std::sin(around)));
                const Vec3 t(glm::dvec3(-std::sin(around), 0, -std::cos(around)));
                normals.push_back(n);
                for (int c = 0; c < 3; ++c) {
                    positions_.push_back(2 * n[c]);
                    numbers_.push_back(side * n[c]);
                    tangents.push_back(t[c]);
                }
                tangents.push_back(1);
            }
        }
        std::vector<std::uint16_t> indices;
        for (std::uint16_t row = 0; row < rows; ++row) {
            for (std::uint16_t column = 0; column < columns; ++column) {
                const auto at = static_cast<std::uint16_t>(row * (columns + 1) + column);
                const auto below = static_cast<std::uint16_t>(at + columns + 1);
                const auto right = static_cast<std::uint16_t>(at + 1);
                const auto across = static_cast<std::uint16_t>(below + 1);
                for (const std::uint16_t corner : {at, below, right, right, below, across})
                    indices.push_back(corner);
            }
        }
        const std::string position = text(writer.add_floats(positions_, "VEC3", 3));
        attributes =
            R"("POSITION":)" + position + R"(,"NORMAL":)" +
            text(writer.add_floats(numbers_, "VEC3", 3)) + R"(,"TANGENT":)" +
            text(writer.add_floats(tangents, "VEC4", 4)) + R"(,"TEXCOORD_0":)" +
            text(writer.add_floats(std::vector<float>(2 * normals.size(), 0.5F), "VEC2", 2));
        indices_ = text(writer.add_indices(indices));
    }

    static std::string text(int number) { return std::to_string(number); }

    /// Binds all vertices to joints 0 and 1, in equal parts.
    void bind() {
        std::vector<std::uint8_t> joints;
        std::vector<float> weights;
        for (std::size_t i = 0; i < normals.size(); ++i) {
            joints.insert(joints.end(), {0, 1, 0, 0});
            weights.insert(weights.end(), {0.5F, 0.5F, 0, 0});
        }
        attributes += R"(,"JOINTS_0":)" + text(writer.add(joints, "VEC4", 5121, 4)) +
                      R"(,"WEIGHTS_0":)" + text(writer.add_floats(weights, "VEC4", 4));
    }

    [[nodiscard]] SceneDescription scene(const std::string& primitive, const std::string& members,
                                         const std::string& mesh = {}) const {
        return must_describe(writer.glb(
            R"("textures":[{"source":0}],"images":[{"uri":"data:,x"}],
            "materials":[{"normalTexture":{"index":0}}],"meshes":[{"name":"ball","primitives":[{
            "material":0,"attributes":{)" +
            attributes + R"(},"indices":)" + indices_ + primitive + "}]" + mesh + "}]" + members));
    }
    /// Skinned by two joints with this transform.
    [[nodiscard]] SceneDescription posed(const std::string& joint) const {
        return scene("", R"(,"skins":[{"joints":[1,2]}],"nodes":[{"mesh":0,"skin":0},{)" + joint +
                             "},{" + joint + "}]");
    }

    GlbWriter writer;
    std::string attributes;
    std::vector<Vec3> normals;

private:
    std::vector<float> positions_, numbers_;
    std::string indices_;
};

const GeometryDescription& shown(const SceneDescription& scene) {
    return scene.objects[scene.objects[scene.root].instances.at(0).object].geometries.at(0);
}

float worst(const std::vector<Vec3>& found, const std::vector<Vec3>& expected) {
    REQUIRE(found.size() == expected.size());
    float most = 0;
    for (std::size_t i = 0; i < found.size(); ++i)
        most = std::max(most, glm::length(found[i] - expected[i]));
    return most;
}

bool warns_of(const SceneDescription& scene, const std::string& text) {
    for (const std::string& warning : scene.warnings)
        if (contains(warning, text)) return true;
    return false;
}

}  // namespace

TEST_CASE("a skin and a target that move nothing leave the file's normals, across a seam, too") {
    Sphere sphere;
    const auto plain = sphere.scene("", R"(,"nodes":[{"mesh":0}])");
    CHECK(shown(plain).normals == sphere.normals);
    REQUIRE(shown(plain).tangents.size() == sphere.normals.size());
    const std::string zeros = Sphere::text(
        sphere.writer.add_floats(std::vector<float>(3 * sphere.normals.size()), "VEC3", 3));
    const auto still = sphere.scene(R"(,"targets":[{"POSITION":)" + zeros + "}]",
                                    R"(,"nodes":[{"mesh":0}])", R"(,"weights":[0])");
    CHECK(worst(shown(still).normals, sphere.normals) < 1e-6F);
    CHECK(shown(still).tangents == shown(plain).tangents);
    sphere.bind();
    const auto posed = sphere.posed("");
    CHECK(worst(shown(posed).normals, sphere.normals) < 1e-6F);
    for (std::size_t i = 0; i < sphere.normals.size(); ++i)
        CHECK(glm::length(shown(posed).tangents[i] - shown(plain).tangents[i]) < 1e-6F);
    CHECK_FALSE(warns_of(posed, "NORMAL"));
}

TEST_CASE("a joint takes normals to the world by its inverse transpose, tangents as it is") {
    Sphere sphere;
    sphere.bind();
    // A quarter turn about z after a stretch along x.
    const auto scene =
        sphere.posed(R"("rotation":[0,0,0.7071067811865476,0.7071067811865476],"scale":[4,1,2])");
    const auto& plain = sphere.scene("", R"(,"nodes":[{"mesh":0}])");
    for (std::size_t i = 0; i < sphere.normals.size(); ++i) {
        const Vec3 n = sphere.normals[i];
        const Vec4 t = shown(plain).tangents[i];
        CHECK(glm::length(shown(scene).normals[i] - glm::normalize(Vec3(-n.y, n.x / 4, n.z / 2))) <
              1e-5F);
        CHECK(glm::length(shown(scene).tangents[i] -
                          Vec4(glm::normalize(Vec3(-t.y, 4 * t.x, 2 * t.z)), t.w)) < 1e-5F);
    }
}

TEST_CASE("joints that mirror turn normals with the winding, and those that flatten leave some") {
    Sphere sphere;
    sphere.bind();
    const auto mirrored = sphere.posed(R"("scale":[-1,1,1])");
    CHECK_FALSE(warns_of(mirrored, "point against"));
    CHECK(shown(mirrored).tangents[30].w == 1);
    for (std::size_t i = 0; i < sphere.normals.size(); ++i) {
        const Vec3 n = sphere.normals[i];
        CHECK(glm::length(shown(mirrored).normals[i] - Vec3(n.x, -n.y, -n.z)) < 1e-5F);
    }
    const auto flat = sphere.posed(R"("scale":[1,1,0])");
    for (const Vec3& n : shown(flat).normals)
        CHECK(std::abs(n.z) == doctest::Approx(n == Vec3(0) ? 0 : 1));
    const auto point = sphere.posed(R"("scale":[0,0,0])");
    for (const Vec3& n : shown(point).normals) CHECK(n == Vec3(0));
}

TEST_CASE("targets move normals and tangents by their weights") {
    Sphere sphere;
    const std::size_t count = sphere.normals.size();
    std::vector<float> differences;
    for (std::size_t i = 0; i < count; ++i) differences.insert(differences.end(), {0.6F, 0, -0.2F});
    const std::string first = Sphere::text(sphere.writer.add_floats(differences, "VEC3", 3));
    const auto scene =
        sphere.scene(R"(,"targets":[{"NORMAL":)" + first + R"(,"TANGENT":)" + first + "}]",
                     R"(,"nodes":[{"mesh":0,"weights":[0.5]}])");
    const auto plain = sphere.scene("", R"(,"nodes":[{"mesh":0}])");
    std::vector<Vec3> expected;
    for (const Vec3& n : sphere.normals)
        expected.push_back(glm::normalize(n + Vec3(0.3F, 0, -0.1F)));
    CHECK(worst(shown(scene).normals, expected) < 1e-6F);
    const Vec4 t = shown(plain).tangents[30];
    CHECK(glm::length(shown(scene).tangents[30] -
                      Vec4(glm::normalize(Vec3(t) + Vec3(0.3F, 0, -0.1F)), 1)) < 1e-6F);

    // Normals alone are no reason to refuse a scene.
    const std::string few = Sphere::text(sphere.writer.add_floats({0, 0, 1}, "VEC3", 3));
    for (const std::string& bad : {few, std::string("77"), std::string("-3")}) {
        CAPTURE(bad);
        const auto left = sphere.scene(R"(,"targets":[{"NORMAL":)" + bad + "}]",
                                       R"(,"nodes":[{"mesh":0,"weights":[1]}])");
        CHECK(worst(shown(left).normals, sphere.normals) < 1e-6F);
        CHECK(warns_of(left, "NORMAL"));
    }
}

TEST_CASE("a deformed mesh without normals in its file is flat, as any other") {
    GlbWriter writer;
    writer.add_floats({0, 0, 0, 1, 0, 0, 0, 1, 0}, "VEC3", 3);
    const auto scene = must_describe(
        writer.glb(R"("meshes":[{"primitives":[{"attributes":{"POSITION":0},"targets":[{
            "POSITION":0,"NORMAL":0}]}],"weights":[1]}],"nodes":[{"mesh":0}])"));
    CHECK(shown(scene).normals.empty());
    CHECK(scene.warnings.empty());
}

TEST_CASE("a mesh of which the normals point against the faces is named, with its counts") {
    const Sphere good;
    CHECK_FALSE(warns_of(good.scene("", R"(,"nodes":[{"mesh":0}])"), "against"));
    const Sphere bad(-1);
    const auto scene = bad.scene("", R"(,"nodes":[{"mesh":0},{"mesh":0,"weights":[1]}])");
    // Those at one pole have no area at all.
    CHECK(warns_of(scene,
                   "mesh 0 ('ball'): the NORMALs of 380 of its 400 triangles point against "
                   "the faces. Lit pictures"));
}

TEST_CASE("normals without a direction are named once, with the counts of the first mesh") {
    constexpr float infinity = std::numeric_limits<float>::infinity();
    for (const float x : {0.0F, std::nanf(""), infinity}) {
        CAPTURE(x);
        GlbWriter writer;
        writer.add_floats({0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0}, "VEC3", 3);
        // The fourth vertex belongs to the second triangle alone.
        writer.add_floats({0, 0, 1, 0, 0, 1, 0, 0, 1, x, 0, 0}, "VEC3", 3);
        writer.add_indices({0, 1, 2, 2, 1, 3, 3, 3, 3});
        const std::string mesh =
            R"({"primitives":[{"attributes":{"POSITION":0,"NORMAL":1},"indices":2}]})";
        const auto scene = must_describe(writer.glb(R"("meshes":[)" + mesh + "," + mesh + "," +
                                                    mesh + R"(],"nodes":[{"mesh":0},{"mesh":1},
                                                    {"mesh":2}])"));
        REQUIRE(scene.warnings.size() == 1);
        CHECK(scene.warnings[0] ==
              "mesh 0: the NORMALs of 1 of its 3 triangles are 0 or not finite, and so are some of "
              "2 other meshes; such faces are shown flat");
        CHECK(Snapshot::build(scene).has_value());
    }
}
