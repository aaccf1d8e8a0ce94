// The readers of engine/assets/formats, with files of a few lines.
#include "engine/assets/formats/formats.h"

#include "engine/assets/formats/obj_names.h"
#include "engine/queries/base_colour.h"
#include "engine/scene/snapshot.h"
#include "tests/unit/engine/assets/samples.h"

#include <nlohmann/json.hpp>

#include <cmath>
#include <string>

using namespace raynest;

namespace {

Result<SceneDescription> read(const std::string& name, const std::string& text,
                              FileOptions options = {}, WorldPoint origin = {}) {
    const test::Bytes bytes = test::to_bytes(text);
    ImportRequest request;
    request.source = name;
    request.files.push_back({name, bytes});
    request.options = options;
    request.origin = origin;
    const FileFormat* format = find_format(name);
    REQUIRE(format != nullptr);
    auto content = format->read(request, ImportLimits{});
    if (!content) return tl::unexpected<Error>(content.error());
    return place(std::move(*content), request, ImportLimits{});
}

SceneDescription must_read(const std::string& name, const std::string& text,
                           FileOptions options = {}, WorldPoint origin = {}) {
    auto scene = read(name, text, options, origin);
    REQUIRE_MESSAGE(scene.has_value(), (scene ? "" : scene.error().message));
    return *scene;
}

std::string refusal(const std::string& name, const std::string& text) {
    const auto scene = read(name, text);
    REQUIRE_FALSE(scene.has_value());
    CHECK(scene.error().message.find('\n') == std::string::npos);
    return scene.error().message;
}

double area_of(const GeometryDescription& geometry) {
    double area = 0;
    for (std::size_t i = 0; i + 2 < geometry.indices.size(); i += 3) {
        const Vec3 a = geometry.positions[geometry.indices[i]];
        const Vec3 b = geometry.positions[geometry.indices[i + 1]];
        const Vec3 c = geometry.positions[geometry.indices[i + 2]];
        const double part = double{glm::cross(b - a, c - a).z} / 2;
        CHECK(part * area >= 0);  // none turns the other way, as a fan's do in a concave polygon
        area += part;
    }
    return area;
}

const std::string one_triangle = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";

}  // namespace

TEST_CASE("an OBJ's corners become vertices by position, texture coordinate and normal") {
    const auto scene = must_read("a.obj", one_triangle +
                                              "v 1 1 0\nvt 0 0\nvt 1 0\nvn 0 0 1\nvn 0 1 0\n"
                                              "f 1/1/1 2/1/1 3/2/1\nf 3/2/1 2/1/1 4/2/2\n");
    REQUIRE(scene.objects.size() == 1);
    const GeometryDescription& geometry = scene.objects[0].geometries[0];
    CHECK(geometry.positions.size() == 4);
    CHECK(geometry.indices == std::vector<std::uint32_t>{0, 1, 2, 2, 1, 3});
    CHECK(geometry.normals[3] == Vec3(0, 1, 0));
    CHECK(geometry.texcoords[0][2] == Vec2(1, 1));  // OBJ counts from below
    // The same position with another normal is another vertex; normals count if all corners have
    // them.
    CHECK(must_read("a.obj",
                    one_triangle + "vn 0 0 1\nvn 0 1 0\nf 1//1 2//1 3//1\nf 1//2 2//2 3//2\n")
              .objects[0]
              .geometries[0]
              .positions.size() == 6);
    CHECK(must_read("a.obj", one_triangle + "vn 0 0 1\nf 1//1 2 3\n")
              .objects[0]
              .geometries[0]
              .normals.empty());
}

TEST_CASE(
    "an OBJ's objects are named, go on where they come again, and hold a geometry per material") {
    const auto scene =
        must_read("a.obj", one_triangle +
                               "o a\nusemtl x\nf 1 2 3\nusemtl y\nf 1 2 3\ng of a\nf 1 2 3\n"
                               "o b\nf -3 -2 -1\no a\nusemtl x\nf 3 2 1\no empty\n");
    REQUIRE(scene.objects.size() == 3);
    CHECK(scene.objects[0].name == "a");
    CHECK(scene.objects[0].geometries.size() == 2);
    CHECK(scene.objects[0].geometries[0].indices.size() == 6);
    CHECK(scene.objects[1].name == "b");
    const auto& placed = scene.objects[scene.root].instances;
    REQUIRE(placed.size() == 2);
    CHECK(placed[1].name == "b");
    CHECK(scene.materials.size() == 2);
    // Groups name the objects of a file without "o".
    CHECK(
        must_read("a.obj", one_triangle + "g left\nf 1 2 3\ng right\nf 1 2 3\n").objects[1].name ==
        "right");
}

TEST_CASE("polygons keep their area, convex, concave, turned, or with equal corners") {
    const auto area = [](const std::string& points, const std::string& face) {
        return area_of(must_read("a.obj", points + face).objects[0].geometries[0]);
    };
    const std::string arrow = "v 0 0 0\nv 2 -2 0\nv 0 2 0\nv -2 -2 0\n";
    CHECK(area(arrow, "f 1 2 3 4\n") == doctest::Approx(4));
    CHECK(area(arrow, "f 2 3 4 1\n") == doctest::Approx(4));
    CHECK(area(arrow, "f 4 3 2 1\n") == doctest::Approx(-4));
    const std::string comb =
        "v 0 0 0\nv 5 0 0\nv 5 3 0\nv 4 3 0\nv 4 1 0\nv 3 1 0\nv 3 3 0\nv 2 3 0\nv 2 1 0\nv 1 1 0\n"
        "v 1 3 0\nv 0 3 0\n";
    CHECK(area(comb, "f 1 2 3 4 5 6 7 8 9 10 11 12\n") == doctest::Approx(11));
    CHECK(area(one_triangle + "v 1 1 0\n", "f 1 2 2 4 3\n") == doctest::Approx(1));
}

TEST_CASE("PLY: elements and properties in any order, colours of each type, big-endian numbers") {
    const auto scene = must_read(
        "a.ply",
        "ply\nformat ascii 1.0\nobj_info x\nelement edge 1\nproperty int a\nelement vertex 3\n"
        "property float nx\nproperty float ny\nproperty float nz\nproperty list uchar int other\n"
        "property double z\nproperty double y\nproperty double x\nproperty float red\n"
        "property ushort green\nproperty uchar blue\nproperty uchar alpha\nelement face 1\n"
        "property float q\nproperty list uchar uint vertex_indices\nend_header\n7\n"
        "0 0 1 2 5 5 3 2 1 1 65535 9 128\n0 0 1 0 3 2 2 0.5 0 0 0\n0 0 1 0 4 2 1 0 0 0 0\n0.5 3 0 "
        "1 2\n");
    const GeometryDescription& geometry = scene.objects[0].geometries[0];
    CHECK(geometry.positions[0] == Vec3(1, 2, 3));
    CHECK(geometry.normals[1] == Vec3(0, 0, 1));
    CHECK(std::vector(geometry.colours.begin(), geometry.colours.begin() + 5) ==
          std::vector<std::uint8_t>{255, 255, 9, 128, 128});
    std::string big =
        "ply\nformat binary_big_endian 1.0\nelement vertex 1\nproperty short x\n"
        "property uchar y\nproperty float z\nproperty float radius\nend_header\n";
    big += std::string("\xFF\xFE\x07\x3F\x80\0\0\x40\0\0\0", 11);
    const auto points = must_read("a.ply", big);
    CHECK(points.warnings.empty());
    CHECK(must_read("a.ply", big, {.radius = 9}).warnings ==
          std::vector<std::string>{
              "`radius` changes nothing: the file has a radius for each of its points"});
    CHECK(points.objects[0].record_type == "sphere");
    float sphere[4];
    std::memcpy(sphere, points.objects[0].records.data(), sizeof sphere);
    CHECK(Vec4(sphere[0], sphere[1], sphere[2], sphere[3]) == Vec4(-2, 7, 1, 2));
}

TEST_CASE("points that are not finite are left out with a count") {
    const std::string cloud =
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        "property float z\nend_header\n0 0 0\nnan nan nan\n1e30 0 0\n";
    const auto scene = must_read("a.ply", cloud, {.radius = 1});
    CHECK(scene.objects[0].record_bounds.size() == 1);
    CHECK(scene.skipped.at("points_not_finite") == 2);
    CHECK(refusal("a.ply", cloud).find("`radius`") != std::string::npos);
}

TEST_CASE("points have colours, those that are left out too") {
    const std::string cloud =
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        "property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n"
        "end_header\n0 0 0 255 0 0\nnan 0 0 1 2 3\n5 0 0 0 0 255\n";
    const auto scene = must_read("a.ply", cloud, {.radius = 1});
    CHECK(scene.objects[0].record_colours ==
          std::vector<std::uint8_t>{255, 0, 0, 255, 0, 0, 255, 255});
    const auto built = Snapshot::build(scene);
    REQUIRE(built.has_value());
    HitRecord hit;
    hit.hit = 1;
    hit.object = (*built)->view().root;
    hit.triangle = 0;
    CHECK(base_colour((*built)->view(), hit) == Vec3(1, 0, 0));
    hit.triangle = 1;
    CHECK(base_colour((*built)->view(), hit) == Vec3(0, 0, 1));
}

TEST_CASE("unit, axes and origin apply in double before rounding") {
    const std::string far =
        "v 5000000.001 1 2\nv 5000000.002 1 2\nv 5000000.001 1.001 2\nf 1 2 3\n";
    const auto scene = must_read("a.obj", far, {.unit = 0.5, .z_up = true, .auto_origin = true});
    CHECK(scene.origin == WorldPoint{2500000, 1, 1});
    CHECK(std::abs(scene.objects[0].geometries[0].positions[1].x - 0.001F) < 1e-9F);
    CHECK(scene.objects[0].geometries[0].positions[2].y == doctest::Approx(0.5005 - 1));
    CHECK(must_read("a.obj", far, {}, {5000000, 0, 0}).rounding < 1e-7);
    CHECK(must_read("a.obj", far).rounding > 1e-4);
    CHECK(must_read("a.obj", one_triangle + "f 1 2 3", {.auto_origin = true}).origin ==
          WorldPoint{});
}

TEST_CASE("numbers as other programs write them") {
    const auto scene =
        must_read("a.obj", "v +1 1.e0 .5\nv 1E+1 -0 1e-400 # far\rv\t0 0 0\r\nf 1 2 \\\n 3\n");
    const auto& positions = scene.objects[0].geometries[0].positions;
    CHECK(positions[0] == Vec3(1, 1, 0.5));
    CHECK(positions[1] == Vec3(10, 0, 0));
    CHECK(refusal("a.obj", "v 1,5 2 3\n").find("line 1: '1,5'") != std::string::npos);
}

TEST_CASE("files of an OBJ stay in its folder") {
    CHECK(file_of_name("scene.obj", "a/../b c.mtl") == "b c.mtl");
    CHECK(file_of_name("sub/x.mtl", "..\\50%25.png") == "50%25.png");
    for (const char* name :
         {"../x.mtl", "/etc/passwd", "a/../../x", "\\x", "C:\\x", "", "http://x/y"})
        CHECK_FALSE(file_of_name("scene.obj", name).has_value());
    CHECK(picture_of_map("-s 1 2 3 -mm 0 1 -clamp on my leaf.png") == "my leaf.png");
    CHECK(picture_of_map("-o 1 2 3.png") == "3.png");
    CHECK(picture_of_map("-") == "");
    const test::Bytes obj =
        test::to_bytes("mtllib a.mtl\n mtllib ../b.mtl\n#mtllib c.mtl\nmtllib a.mtl\n");
    CHECK(files_named_by("X.OBJ", obj, 9) == std::vector<std::string>{"a.mtl"});
    CHECK(files_named_by("x.ply", obj, 9).empty());
}

TEST_CASE("an MTL gives colour, opacity and light, and pictures that are there") {
    const std::string obj =
        one_triangle + "mtllib a.mtl\nmtllib ../x\nusemtl red\nf 1 2 3\nusemtl glow\nf 1 2 3\n";
    const std::string mtl =
        "newmtl red\nKd 1 0.5 0\nd 0.25\nmap_Kd -s 2 2 leaf.png\nnewmtl glow\nKd 2 -1 nan\n"
        "Ke 3 0 0\nTr 0\nmap_Kd ../leaf.png\nnewmtl red\nKd 0 0 0\n";
    const test::Bytes main = test::to_bytes(obj);
    const test::Bytes materials = test::to_bytes(mtl);
    ImportRequest request;
    request.source = "a.obj";
    request.files = {{"a.obj", main}, {"a.mtl", materials}};
    const auto content = read_obj(request, ImportLimits{});
    REQUIRE(content.has_value());
    REQUIRE(content->materials.size() == 2);
    CHECK(content->materials[0].base_colour == Vec4(1, 0.5, 0, 0.25));
    CHECK(content->materials[0].alpha_mode == AlphaMode::blend);
    CHECK(content->materials[0].texture == no_id);
    CHECK(content->materials[1].base_colour == Vec4(1, 0, 0, 1));
    CHECK(content->materials[1].surface.emission == Vec3(3, 0, 0));
    REQUIRE(content->warnings.size() == 3);
    CHECK(content->warnings[0].find("'leaf.png' is missing") != std::string::npos);
    CHECK(content->warnings[1].find("'../leaf.png' leaves the scene's folder") !=
          std::string::npos);
    CHECK(content->warnings[2].find("mtllib '../x' leaves the scene's folder") !=
          std::string::npos);
    const test::Bytes bad = test::to_bytes("newmtl a\nKd x\n");
    request.files[1].bytes = bad;
    const auto refused = read_obj(request, ImportLimits{});
    REQUIRE_FALSE(refused.has_value());
    CHECK(refused.error().message == "'a.mtl' line 2: 'x' is no number, which Kd needs");
}

TEST_CASE("names in an OBJ and its MTL files, as all readers of them find them") {
    std::ifstream table(RAYNEST_SOURCE_DIR "/tests/golden/obj_names.json");
    for (const auto& entry : nlohmann::json::parse(table)) {
        const auto text = entry["text"].get<std::string>();
        CAPTURE(text);
        CHECK(files_named_by(entry["file"].get<std::string>(), std::as_bytes(std::span(text)),
                             99) == entry["names"].get<std::vector<std::string>>());
    }
}

TEST_CASE("rows of PLY and OFF end where their formats say") {
    const std::string header =
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        "property float z\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n";
    const auto more = must_read("a.ply", header + "0 0 0 7\n1 0 0\n0 1 0\n3 0 1 2 9 9\n3 0 2 1\n");
    CHECK(more.objects[0].geometries[0].indices == std::vector<std::uint32_t>{0, 1, 2, 0, 2, 1});
    REQUIRE(more.warnings.size() == 1);
    CHECK(more.warnings[0] == "2 rows have more numbers than the header says, which are left out");
    const auto split = must_read("a.ply", header + "0 0\n0\n1 0 0\n0 1 0\n3 0\n1 2\n3 0 2 1\n");
    CHECK(split.warnings.empty());
    // OFF: the end of a line counts before a colour alone.
    const auto off = must_read("a.off", "OFF\n3 1 0\n0 0\n0#a\n1 0 0\n\n0 1 0\n3 0\n1 # b\n2\n");
    CHECK(off.objects[0].geometries[0].indices == std::vector<std::uint32_t>{0, 1, 2});
    CHECK(off.warnings.empty());
    const auto coloured = must_read("a.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2 255 0 0\n");
    REQUIRE(coloured.warnings.size() == 1);
    CHECK(coloured.warnings[0].find("colours of its faces") != std::string::npos);
}

TEST_CASE("PLY has strips, and faces before the vertices") {
    const std::string vertices =
        "element vertex 4\nproperty float x\nproperty float y\nproperty float z\n";
    const std::string points = "0 0 0\n1 0 0\n0 1 0\n1 1 0\n", head = "ply\nformat ascii 1.0\n";
    const auto strips =
        must_read("a.ply", head + vertices +
                               "element tristrips 1\nproperty list int int vertex_indices\n"
                               "end_header\n" +
                               points + "8 0 1 2 3 -1 1 3 2\n");
    CHECK(strips.objects[0].geometries[0].indices ==
          std::vector<std::uint32_t>{0, 1, 2, 2, 1, 3, 1, 3, 2});
    const auto early =
        must_read("a.ply", head + "element face 1\nproperty list uchar int vertex_indices\n" +
                               vertices + "end_header\n4 0 1 3 2\n" + points);
    CHECK(area_of(early.objects[0].geometries[0]) == doctest::Approx(1));
    const auto both =
        must_read("a.ply", head + "element face 1\nproperty list uchar int vertex_indices\n" +
                               "element tristrips 1\nproperty list int int vertex_indices\n" +
                               vertices + "end_header\n3 0 1 2\n3 1 3 2\n" + points);
    CHECK(both.objects[0].geometries[0].indices == std::vector<std::uint32_t>{0, 1, 2, 1, 3, 2});
    // A property of one letter is no colour.
    const auto range = must_read(
        "a.ply", head +
                     "element vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
                     "property uchar red\nproperty uchar green\nproperty uchar blue\n"
                     "property float r\nelement face 1\nproperty list uchar int vertex_indices\n"
                     "end_header\n0 0 0 255 0 0 0\n1 0 0 255 0 0 0\n0 1 0 255 0 0 0\n3 0 1 2\n");
    CHECK(range.objects[0].geometries[0].colours[0] == 255);
}

TEST_CASE("an OBJ's face needs vertices alone") {
    const auto scene = must_read(
        "a.obj", one_triangle + "vn 0 0 1#up\nf 1/1/1 2/2/2 3/0/1\nf 1 2\nf 1//1 2//1 3//1\n");
    CHECK(scene.objects[0].geometries[0].indices.size() == 6);
    REQUIRE(scene.warnings.size() == 2);
    const std::string warnings = scene.warnings[0] + scene.warnings[1];
    CHECK(warnings.find("4 corners name a normal or texture coordinate that is not there") !=
          std::string::npos);
    CHECK(warnings.find("fewer than three corners") != std::string::npos);
    CHECK(refusal("a.obj", one_triangle + "f 1 2 4\n").find("uses vertex 4 of 3") !=
          std::string::npos);
    CHECK(refusal("a.obj", std::string("\xFF\xFEv\0 \0", 6)).find("UTF-16") != std::string::npos);
}

TEST_CASE("damaged files are refused by the line") {
    for (const auto& [name, text, words] : {
             std::tuple{"a.obj", "v 0 0 0\nf 1 1 2\n", "line 2: the face uses vertex 2 of 1"},
             std::tuple{"a.obj", "f 1 2 3\n", "vertex 1 of 0"},
             std::tuple{"a.obj", "v 0 0\n", "the end of the line is no coordinate"},
             std::tuple{"a.ply",
                        "ply\nformat ascii 1.0\nelement vertex 1\nproperty list float int x\n",
                        "line 4"},
             std::tuple{"a.ply", "ply\nformat ascii 2.0\nend_header\n", "no triangle"},
             std::tuple{"a.stl", "solid x\nvertex 1 2 3\nvertex 1 2 3\nendfacet\n", "2 vertices"},
             std::tuple{"a.off", "OFF 3 1\n0 0 0\n0 0 1\n0 1 0\n3 0 1\n", "face 0 of 1"},
             std::tuple{"a.off", "OFF -1 1 0\n", "no count"},
             std::tuple{"a.laz", "x", "laszip"},
         })
        CHECK_MESSAGE(refusal(name, text).find(words) != std::string::npos, refusal(name, text));
}
