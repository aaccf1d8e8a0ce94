// Compares every vertex of skins with an evaluation in float64 that shares no code with the
// importer.
#include "engine/scene/motion/skinning.h"
#include "engine/scene/snapshot.h"
#include "tests/unit/engine/assets/describe.h"

#include <nlohmann/json.hpp>

#include <cmath>

using namespace raynest;
using test::contains;
using test::describe;
using test::GlbWriter;
using test::must_describe;
using test::refusal;

namespace {

using Point = std::array<double, 3>;
using Matrix4 = std::array<std::array<double, 4>, 4>;

Matrix4 translation(double x, double y, double z) {
    return {{{1, 0, 0, x}, {0, 1, 0, y}, {0, 0, 1, z}, {0, 0, 0, 1}}};
}
/// A quarter turn about z: x becomes y.
constexpr Matrix4 quarter_turn{{{0, -1, 0, 0}, {1, 0, 0, 0}, {0, 0, 1, 0}, {0, 0, 0, 1}}};
const std::string quarter_turn_json = R"("rotation":[0,0,0.7071067811865476,0.7071067811865476])";

Matrix4 operator*(const Matrix4& a, const Matrix4& b) {
    Matrix4 product{};
    for (std::size_t i = 0; i < 4; ++i) {
        for (std::size_t j = 0; j < 4; ++j) {
            for (std::size_t k = 0; k < 4; ++k) product[i][j] += a[i][k] * b[k][j];
        }
    }
    return product;
}

Point operator*(const Matrix4& m, const Point& p) {
    Point moved{};
    for (std::size_t i = 0; i < 3; ++i)
        moved[i] = m[i][0] * p[0] + m[i][1] * p[1] + m[i][2] * p[2] + m[i][3];
    return moved;
}

Point blend(const Point& a, double weight_a, const Point& b, double weight_b) {
    Point sum{};
    for (std::size_t i = 0; i < 3; ++i)
        sum[i] = (weight_a * a[i] + weight_b * b[i]) / (weight_a + weight_b);
    return sum;
}

void check_point(const Vec3& got, const Point& expected) {
    CAPTURE(got.x);
    CAPTURE(got.y);
    CAPTURE(got.z);
    CHECK(std::abs(double{got.x} - expected[0]) < 1e-6);
    CHECK(std::abs(double{got.y} - expected[1]) < 1e-6);
    CHECK(std::abs(double{got.z} - expected[2]) < 1e-6);
}

/// Returns the geometry that an instance of the scene's root shows.
const GeometryDescription& geometry_of(const SceneDescription& scene, std::size_t instance) {
    return scene.objects[scene.objects[scene.root].instances.at(instance).object].geometries.at(0);
}

/// Ten vertices beside a chain of two joints, as in simple_skin. The second joint is at (0, 1, 0),
/// and the weights pass from the first to the second on the way up, in quarters.
class Strip {
public:
    static constexpr std::size_t count = 10;
    static constexpr double share[5] = {0, 0.25, 0.5, 0.75, 1};  // weight of joint 1, by row

    static Point position(std::size_t i) {
        return {static_cast<double>(i % 2), static_cast<double>(i / 2) * 0.5, 0};
    }
    static constexpr double shift[3] = {-0.5, -1, 0};  // translation of both inverse bind matrices

    GlbWriter writer;
    std::string attributes;
    int indices = 0;
    int inverse_bind = 0;

    Strip() {
        std::vector<float> positions;
        for (std::size_t i = 0; i < count; ++i) {
            for (const double x : position(i)) positions.push_back(static_cast<float>(x));
        }
        attributes = "\"POSITION\":" + std::to_string(writer.add_floats(positions, "VEC3", 3));
        indices = writer.add_indices(
            {0, 1, 3, 0, 3, 2, 2, 3, 5, 2, 5, 4, 4, 5, 7, 4, 7, 6, 6, 7, 9, 6, 9, 8});
        std::vector<float> matrices;
        for (int joint = 0; joint < 2; ++joint) {
            matrices.insert(matrices.end(), {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, -0.5F, -1, 0, 1});
        }
        inverse_bind = writer.add_floats(matrices, "MAT4", 16);
    }

    template <class Joint, class Weight>
    void add_joints(int joint_type, int weight_type, double one, int set = 0) {
        std::vector<Joint> joints;
        std::vector<Weight> weights;
        for (std::size_t i = 0; i < count; ++i) {
            const double second = share[i / 2] * one;
            const Weight row[4] = {static_cast<Weight>(one - second), static_cast<Weight>(second),
                                   0, 0};
            for (std::size_t c = 0; c < 4; ++c) {
                joints.push_back(static_cast<Joint>(c == 1 ? 1 : 0));
                weights.push_back(row[c]);
            }
        }
        add_joints(joints, joint_type, weights, weight_type, set);
    }
    template <class Joint, class Weight>
    void add_joints(const std::vector<Joint>& joints, int joint_type,
                    const std::vector<Weight>& weights, int weight_type, int set = 0) {
        const char* extra = weight_type == 5126 ? "" : ",\"normalized\":true";
        const int first = writer.add(joints, "VEC4", joint_type, 4);
        const int second = writer.add(weights, "VEC4", weight_type, 4, extra);
        attributes += ",\"JOINTS_" + std::to_string(set) + "\":" + std::to_string(first) +
                      ",\"WEIGHTS_" + std::to_string(set) + "\":" + std::to_string(second);
    }

    [[nodiscard]] std::string mesh(const std::string& more = {}) const {
        return "\"meshes\":[{\"primitives\":[{\"attributes\":{" + attributes +
               "},\"indices\":" + std::to_string(indices) + more + "}]}]";
    }
    /// Returns nodes: node 0 shows the mesh, 1 and 2 are joints; the second is bent by a quarter
    /// turn.
    [[nodiscard]] std::string bent(const std::string& skin_members) const {
        return R"(,"skins":[{"joints":[1,2])" + skin_members +
               R"(}],"nodes":[{"mesh":0,"skin":0,"children":[1]},
               {"translation":[0,1,0],"children":[2]},{)" +
               quarter_turn_json + "}]";
    }
    [[nodiscard]] std::string bound() const {
        return ",\"inverseBindMatrices\":" + std::to_string(inverse_bind);
    }
    static Point bent_position(const Point& p, double second) {
        const Matrix4 bind = translation(shift[0], shift[1], shift[2]);
        const Matrix4 first_joint = translation(0, 1, 0);
        return blend(first_joint * bind * p, 1 - second, first_joint * quarter_turn * bind * p,
                     second);
    }
};

void check_bent(const SceneDescription& scene) {
    const GeometryDescription& geometry = geometry_of(scene, 0);
    CHECK(scene.objects[scene.root].instances[0].transform == Transform{});
    REQUIRE(geometry.positions.size() == Strip::count);
    for (std::size_t i = 0; i < Strip::count; ++i) {
        CAPTURE(i);
        check_point(geometry.positions[i],
                    Strip::bent_position(Strip::position(i), Strip::share[i / 2]));
    }
    CHECK(scene.warnings.empty());
}

}  // namespace

TEST_CASE("a skinned mesh takes its place from its joints and not from its node") {
    if (test::have_shared_scenes()) {
        const auto scene = test::must_describe_shared("odd/skin_joint_x5_node_x100.glb");
        CHECK(scene.objects[scene.root].instances[0].transform == Transform{});
        for (const Vec3& p : geometry_of(scene, 0).positions) CHECK((p.x >= 5 && p.x <= 6));
        CHECK(scene.warnings.empty());
    }
    Strip strip;
    strip.add_joints<std::uint8_t, float>(5121, 5126, 1);
    // The node is moved, scaled to zero, and a child of another; its name keeps both.
    const auto scene = must_describe(strip.writer.glb(
        strip.mesh() + R"(,"skins":[{"joints":[2,3],"skeleton":2)" + strip.bound() + R"(}],
        "nodes":[{"name":"body","mesh":0,"skin":0,"translation":[100,0,0],"scale":[0,0,0]},
        {"name":"all","translation":[0,7,0],"children":[0]},
        {"translation":[0,1,0],"children":[3]},{)" +
        quarter_turn_json + "}]"));
    check_bent(scene);
    const PathNodeDescription& body = scene.path_nodes[scene.placed_nodes.at(0)];
    CHECK(body.name == "body");
    CHECK(scene.path_nodes[body.parent].name == "all");
}

TEST_CASE("every vertex of simple_skin with joint 2 bent agrees with float64") {
    if (!test::have_shared_scenes()) return;
    std::ifstream file(test::shared_scene("odd/simple_skin.gltf"));
    auto json = nlohmann::json::parse(file);
    json["nodes"][2]["rotation"] = {0, 0, std::sqrt(0.5), std::sqrt(0.5)};
    const auto scene = must_describe(test::to_bytes(json.dump()), "simple_skin.gltf");
    const GeometryDescription& geometry = geometry_of(scene, 0);
    REQUIRE(geometry.positions.size() == Strip::count);
    for (std::size_t i = 0; i < Strip::count; ++i) {
        CAPTURE(i);
        check_point(geometry.positions[i],
                    Strip::bent_position(Strip::position(i), Strip::share[i / 2]));
    }
}

TEST_CASE("weights may be floats or normalised bytes or shorts, joints bytes or shorts") {
    for (int type = 0; type < 4; ++type) {
        CAPTURE(type);
        Strip strip;
        if (type == 0) strip.add_joints<std::uint8_t, float>(5121, 5126, 1);
        if (type == 1) strip.add_joints<std::uint16_t, float>(5123, 5126, 1);
        // Use the largest multiples of four, so that quarters are whole numbers: sums are not 1.
        if (type == 2) strip.add_joints<std::uint8_t, std::uint8_t>(5121, 5121, 252);
        if (type == 3) strip.add_joints<std::uint16_t, std::uint16_t>(5123, 5123, 65532);
        check_bent(must_describe(strip.writer.glb(strip.mesh() + strip.bent(strip.bound()))));
    }
}

TEST_CASE("a second set of joints counts as the first") {
    Strip strip;
    std::vector<std::uint8_t> joints(40, 0);
    std::vector<float> first(40, 0);
    std::vector<float> second(40, 0);
    for (std::size_t i = 0; i < Strip::count; ++i) {
        first[4 * i] = static_cast<float>(1 - Strip::share[i / 2]);
        second[4 * i + 3] = static_cast<float>(Strip::share[i / 2]);
    }
    strip.add_joints(joints, 5121, first, 5126, 0);
    for (std::size_t i = 3; i < 40; i += 4) joints[i] = 1;
    strip.add_joints(joints, 5121, second, 5126, 1);
    check_bent(must_describe(strip.writer.glb(strip.mesh() + strip.bent(strip.bound()))));
}

TEST_CASE("weights are divided by their sum, and a vertex without any follows its first joint") {
    Strip half;
    half.add_joints<std::uint8_t, float>(5121, 5126, 0.5);
    check_bent(must_describe(half.writer.glb(half.mesh() + half.bent(half.bound()))));

    Strip none;
    none.add_joints(std::vector<std::uint8_t>(40, 1), 5121, std::vector<float>(40, 0), 5126);
    const auto scene = must_describe(none.writer.glb(none.mesh() + none.bent(none.bound())));
    for (std::size_t i = 0; i < Strip::count; ++i)
        check_point(geometry_of(scene, 0).positions[i],
                    Strip::bent_position(Strip::position(i), 1));
}

TEST_CASE("without inverse bind matrices joints move the mesh as it is") {
    Strip strip;
    strip.add_joints<std::uint8_t, float>(5121, 5126, 1);
    const auto scene = must_describe(strip.writer.glb(strip.mesh() + strip.bent("")));
    const Matrix4 joint = translation(0, 1, 0);
    for (std::size_t i = 0; i < Strip::count; ++i) {
        const Point p = Strip::position(i);
        const double second = Strip::share[i / 2];
        check_point(geometry_of(scene, 0).positions[i],
                    blend(joint * p, 1 - second, joint * quarter_turn * p, second));
    }
}

TEST_CASE("a joint that mirrors turns tangents and normals with the side that they belong to") {
    const Affine mirror{-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0},
        turn{0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1, 0};
    const auto moved = [](const Affine& map) {
        Vec3 position(1, 2, 3), normal(0, 0, 1);
        Vec4 tangent(1, 0, 0, 1);
        move_vertex(map, position, &normal, &tangent);
        return std::pair{normal, tangent};
    };
    CHECK(moved(mirror) == std::pair{Vec3(0, 0, -1), Vec4(1, 0, 0, 1)});
    CHECK(moved(turn) == std::pair{Vec3(0, 0, 1), Vec4(0, 1, 0, 1)});
}

TEST_CASE("morph targets move a vertex before its joints do") {
    Strip strip;
    strip.add_joints<std::uint8_t, std::uint8_t>(5121, 5121, 252);
    std::vector<float> differences;
    for (std::size_t i = 0; i < Strip::count; ++i)
        differences.insert(differences.end(), {0.25F, static_cast<float>(i), -2});
    const int target = strip.writer.add_floats(differences, "VEC3", 3);
    const auto scene = must_describe(strip.writer.glb(
        strip.mesh(",\"targets\":[{\"POSITION\":" + std::to_string(target) + "}]") +
        R"(,"skins":[{"joints":[1,2])" + strip.bound() + R"(}],"nodes":[{"mesh":0,"skin":0,
        "weights":[0.5],"children":[1]},{"translation":[0,1,0],"children":[2]},{)" +
        quarter_turn_json + "}]"));
    for (std::size_t i = 0; i < Strip::count; ++i) {
        Point p = Strip::position(i);
        p = {p[0] + 0.125, p[1] + 0.5 * static_cast<double>(i), p[2] - 1};
        check_point(geometry_of(scene, 0).positions[i],
                    Strip::bent_position(p, Strip::share[i / 2]));
    }
}

TEST_CASE("nodes that share a mesh share its geometry only where they share its skin") {
    Strip strip;
    strip.add_joints<std::uint8_t, float>(5121, 5126, 1);
    const auto scene = must_describe(
        strip.writer.glb(strip.mesh() + R"(,"skins":[{"joints":[1,1]},{"joints":[2,2]}],"nodes":[
        {"mesh":0,"skin":0},{"translation":[0,0,5]},{"translation":[0,0,9]},
        {"mesh":0,"skin":1},{"mesh":0,"translation":[0,0,3]},{"mesh":0,"skin":0}])"));
    const auto& instances = scene.objects[scene.root].instances;
    REQUIRE(instances.size() == 4);
    CHECK(geometry_of(scene, 0).positions[0] == Vec3(0, 0, 5));
    CHECK(geometry_of(scene, 1).positions[0] == Vec3(0, 0, 9));
    CHECK(geometry_of(scene, 2).positions[0] == Vec3(0, 0, 0));
    CHECK(instances[2].transform.point({0, 0, 0}) == Vec3(0, 0, 3));
    CHECK(instances[3].object == instances[0].object);
    CHECK(Snapshot::build(scene).has_value());
}

TEST_CASE("equal subtrees with a skin are not shared: the mesh stands in the scene's space") {
    Strip strip;
    strip.add_joints<std::uint8_t, float>(5121, 5126, 1);
    const auto scene =
        must_describe(strip.writer.glb(strip.mesh() + R"(,"skins":[{"joints":[6,6]}],"nodes":[
        {"translation":[0,0,100],"children":[2,3]},{"translation":[0,0,200],"children":[4,5]},
        {"mesh":0,"skin":0},{"mesh":0},{"mesh":0,"skin":0},{"mesh":0},{"translation":[0,0,5]}])"));
    const auto& instances = scene.objects[scene.root].instances;
    REQUIRE(instances.size() == 4);
    std::vector<float> heights;
    for (std::size_t i = 0; i < 4; ++i)
        heights.push_back(instances[i].transform.point(geometry_of(scene, i).positions[0]).z);
    CHECK(heights == std::vector<float>{5, 100, 5, 200});
}

TEST_CASE("joints may stand outside the chosen scene, and a skin without use changes nothing") {
    Strip strip;
    strip.add_joints<std::uint8_t, float>(5121, 5126, 1);
    const auto scene = must_describe(strip.writer.glb(
        strip.mesh() + R"(,"scenes":[{"nodes":[0]}],"skins":[{"joints":[2,2]}],"nodes":[
        {"mesh":0,"skin":0},{"translation":[0,0,5],"children":[2]},{"translation":[0,0,2]},
        {"skin":0}])"));
    CHECK(geometry_of(scene, 0).positions[0] == Vec3(0, 0, 7));

    GlbWriter writer;
    const std::string plain = test::one_triangle_mesh(writer);
    const auto unskinned = must_describe(writer.glb(
        plain +
        R"(,"skins":[{"joints":[0]}],"nodes":[{"mesh":0,"skin":0,"translation":[0,0,5]}])"));
    CHECK(unskinned.objects[unskinned.root].instances[0].transform.point({0, 0, 0}) ==
          Vec3(0, 0, 5));
}

TEST_CASE("hostile skins are refused by name") {
    const float nan = std::nanf("");
    const auto with = [](const std::vector<std::uint8_t>& joints, const std::vector<float>& weights,
                         const std::string& skin) {
        Strip strip;
        strip.add_joints(joints, 5121, weights, 5126);
        return refusal(strip.writer.glb(strip.mesh() + strip.bent(skin)));
    };
    const std::vector<std::uint8_t> joints(40, 0);
    const std::vector<float> weights(40, 0.25F);
    CHECK(contains(with(std::vector<std::uint8_t>(40, 2), weights, ""), "beyond the 2 of skin 0"));
    CHECK(contains(with(std::vector<std::uint8_t>(40, 255), std::vector<float>(40, 0), ""),
                   "beyond the 2 of skin 0"));
    for (const float bad : {nan, -1.0F, INFINITY}) {
        std::vector<float> some = weights;
        some[7] = bad;
        CHECK(contains(with(joints, some, ""), "mesh 0 has 1 skin weights"));
    }
    CHECK(contains(with(std::vector<std::uint8_t>(36, 0), weights, ""), "9 elements of JOINTS"));
    CHECK(contains(with(joints, std::vector<float>(44, 0.25F), ""), "11 elements of WEIGHTS"));

    Strip strip;
    strip.add_joints(joints, 5121, weights, 5126);
    const auto skins = [&](const std::string& skin, const std::string& node = "0") {
        return refusal(strip.writer.glb(strip.mesh() + R"(,"nodes":[{"mesh":0,"skin":)" + node +
                                        R"(}],"skins":[)" + skin + "]"));
    };
    CHECK(contains(skins(R"({"joints":[0]})", "1"), "skin 1"));
    CHECK(contains(skins(R"({"joints":[0]})", "-7"), "skin -7"));
    CHECK(contains(skins(R"({"joints":[0,9]})"), "joint node 9"));
    CHECK(contains(skins(R"({"joints":[-1]})"), "joint node -1"));
    CHECK(contains(skins(R"({"joints":[0],"skeleton":9})"), "skeleton node 9"));
    CHECK(contains(skins(R"({"joints":[0],"inverseBindMatrices":99})"), "accessor 99"));
    CHECK(contains(skins(R"({"joints":[]})"), "skin 0 has no joints"));
    CHECK(contains(skins(R"({"joints":[0,0,0])" + strip.bound() + "}"),
                   "skin 0 has 3 joints but 2 inverseBindMatrices"));
    CHECK(contains(skins(R"({"joints":[0],"inverseBindMatrices":0})"), "wrong type"));
    std::string many = "0";
    for (int i = 0; i < 65536; ++i) many += ",0";
    CHECK(contains(skins(R"({"joints":[)" + many + "]}"), "at most 65536 are allowed"));

    Strip infinite;
    infinite.add_joints(joints, 5121, weights, 5126);
    std::vector<float> matrices(16, 0.0F);
    matrices[5] = nan;
    const int bind = infinite.writer.add_floats(matrices, "MAT4", 16);
    CHECK(contains(
        refusal(infinite.writer.glb(infinite.mesh() +
                                    R"(,"nodes":[{"mesh":0,"skin":0}],"skins":[{"joints":[0],
                                    "inverseBindMatrices":)" +
                                    std::to_string(bind) + "}]")),
        "a matrix that is not finite"));

    Strip wrong_type;
    wrong_type.add_joints(std::vector<float>(40, 0), 5126, weights, 5126);
    CHECK(contains(refusal(wrong_type.writer.glb(wrong_type.mesh() + wrong_type.bent(""))),
                   "JOINTS of the wrong type"));
}

TEST_CASE("a mesh that thousands of nodes pose is read a limited number of times") {
    GlbWriter writer;
    std::vector<float> positions(90000, 0.5F);
    writer.add_floats(positions, "VEC3", 3);
    std::string primitives;
    for (int i = 0; i < 10; ++i) primitives += R"({"attributes":{"POSITION":0},"targets":[{}]},)";
    primitives.pop_back();
    std::string nodes;
    for (int i = 0; i < 3000; ++i) nodes += "{\"mesh\":0,\"weights\":[" + std::to_string(i) + "]},";
    nodes.pop_back();
    CHECK(contains(refusal(writer.glb("\"meshes\":[{\"primitives\":[" + primitives +
                                      "]}],\"nodes\":[" + nodes + "]")),
                   "repeatedly"));
}
