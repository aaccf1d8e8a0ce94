// Texts of paths: every one is unique, and each finds its path again.
#include "engine/assets/gltf/gltf.h"
#include "engine/queries/columns.h"
#include "engine/scene/edits/link.h"
#include "engine/scene/edits/linked_paths.h"
#include "engine/scene/edits/names.h"
#include "engine/scene/format.h"
#include "engine/scene/named_paths.h"
#include "engine/scene/snapshot.h"
#include "tests/unit/engine/assets/samples.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cstring>
#include <iterator>
#include <set>
#include <span>
#include <string>
#include <vector>

using namespace raynest;
using test::place;
using test::translation;

namespace {

std::string text_of(const Snapshot& scene, std::uint64_t path) {
    const auto steps = expand_path(scene, path);
    REQUIRE_MESSAGE(steps.has_value(), (steps ? "" : steps.error().message));
    return path_name(*steps);
}

/// Checks that a text, and each that begins it, names the paths that have it or have it above them.
void check_named(const Snapshot& scene, const std::string& whole,
                 const std::vector<std::string>& texts) {
    std::size_t end = 0;
    do {
        end = whole.find('/', end + 1);
        const std::string text = whole.substr(0, end);
        CAPTURE(text);
        std::vector<bool> wanted, named(texts.size());
        for (const std::string& one : texts) wanted.push_back(glob_matches(text, one));
        std::uint64_t before = 0;
        for (const PathRange& range : named_paths(scene, text)) {
            CHECK((range.first > before || before == 0));
            REQUIRE(range.first < range.end);
            REQUIRE(range.end <= texts.size());
            before = range.end;
            std::fill(named.begin() + static_cast<std::ptrdiff_t>(range.first),
                      named.begin() + static_cast<std::ptrdiff_t>(range.end), true);
        }
        CHECK(named == wanted);
    } while (end != std::string::npos);
}

/// Returns the texts of all paths; checks that no two are equal and each finds its path.
std::vector<std::string> texts_of(const Snapshot& scene) {
    std::vector<std::string> texts;
    for (std::uint64_t path = 0; path < scene.statistics().instances; ++path) {
        texts.push_back(text_of(scene, path));
        const auto found = find_path(scene, texts.back());
        CAPTURE(texts.back());
        REQUIRE_MESSAGE(found.has_value(), (found ? "" : found.error().message));
        CHECK(*found == path);
    }
    CHECK(std::set<std::string>(texts.begin(), texts.end()).size() == texts.size());
    for (const std::string& text : texts) check_named(scene, text, texts);
    return texts;
}

std::string complaint(const Snapshot& scene, const std::string& text) {
    const auto found = find_path(scene, text);
    REQUIRE_FALSE_MESSAGE(found.has_value(), text);
    return found.error().message;
}

/// Returns nodes of a GLB in which mesh 0 is a triangle without a name and mesh 1 one called
/// "quill".
std::shared_ptr<const Snapshot> read_nodes(const std::string& nodes) {
    test::GlbWriter writer;
    const std::string mesh = test::one_triangle_mesh(writer);
    const std::string_view named = "\"name\":\"leaf\",";
    const std::size_t first = mesh.find('{');
    const std::string quill = mesh.substr(first, mesh.rfind(']') - first);
    std::string plain = quill;
    plain.erase(plain.find(named), named.size());
    const std::string two =
        "\"meshes\":[" + plain + ",{\"name\":\"quill\"" + quill.substr(named.size()) + "]";
    const test::Upload upload("scene.glb", writer.glb(two + ",\"nodes\":[" + nodes + "]"));
    const auto scene = describe_gltf(upload.request(), ImportLimits{});
    REQUIRE_MESSAGE(scene.has_value(), (scene ? "" : scene.error().message));
    return test::build_scene(*scene);
}

/// Two subtrees with equal placements but other names: both become the same object.
constexpr const char* equal_subtrees =
    R"({"name":"a","children":[2,3]},{"name":"b","translation":[9,0,0],"children":[5,4]},
       {"name":"x","mesh":0},{"name":"y","mesh":0,"translation":[0,2,0]},
       {"name":"q","mesh":0,"translation":[0,2,0]},{"name":"p","mesh":0})";

}  // namespace

TEST_CASE("of equal subtrees each has its own names and nodes") {
    const auto scene = read_nodes(equal_subtrees);
    REQUIRE(scene->statistics().levels == 3);  // they are shared
    CHECK(texts_of(*scene) == std::vector<std::string>{"a/x", "a/y", "b/p", "b/q"});
    const auto steps = expand_path(*scene, 2);
    REQUIRE(steps->size() == 2);
    CHECK(steps->at(0).node == 1);
    CHECK(steps->at(1).node == 5);
    CHECK(steps->at(1).uid == 5);
    CHECK(steps->at(1).instance == 0);
}

TEST_CASE("the column uid is the node, of equal subtrees too") {
    const auto scene = read_nodes(equal_subtrees);
    const std::vector<std::uint32_t> expected{2, 3, 5, 4};
    for (std::uint64_t path = 0; path < 4; ++path) {
        HitRecord hit;
        hit.hit = 1;
        hit.path = path;
        const std::vector<Ray> rays(1);
        const std::vector<HitRecord> hits{hit};
        ColumnSource source{&scene->view(), rays, hits};
        source.paths = &scene->paths();
        std::uint32_t uid = 0;
        write_column(Field::uid, source, reinterpret_cast<std::byte*>(&uid));
        CHECK(uid == expected[path]);
    }
}

TEST_CASE("names repeated under one parent are numbered in the order of the file") {
    // A camera of the same name counts, and so does every placement of an instanced node.
    const auto scene =
        read_nodes(R"({"name":"stand","children":[2,3,4]},{"name":"stand","children":[5]},
        {"name":"fern","mesh":0},{"name":"fern"},{"name":"fern","mesh":0,"children":[6]},
        {"name":"fern","mesh":0},{"name":"frond","mesh":0})");
    CHECK(texts_of(*scene) == std::vector<std::string>{"stand#0/fern#0", "stand#0/fern#2",
                                                       "stand#0/fern#2/frond", "stand#1/fern"});
}

TEST_CASE("a node without a name is named by its mesh, and one without both is no step") {
    const auto scene = read_nodes(
        R"({"name":"wing","children":[1,2,3]},{"mesh":1},{"mesh":0},{"children":[4,5]},{"mesh":1},
           {"name":"tip","mesh":0})");
    CHECK(texts_of(*scene) ==
          std::vector<std::string>{"wing/quill#0", "wing/#0", "wing/quill#1", "wing/tip"});
}

TEST_CASE("characters with a meaning in path texts are percent-encoded in names") {
    const auto scene = read_nodes(
        R"({"name":"a/b","mesh":0},{"name":"a","children":[2]},{"name":"b","mesh":0},
           {"name":"c#0","mesh":0},{"name":"c","mesh":0},{"name":"c","mesh":0},{"name":"5%","mesh":0},
           {"name":"17","mesh":0},{"name":"17","mesh":0},{"name":"17th","mesh":0})");
    CHECK(texts_of(*scene) == std::vector<std::string>{"a%2Fb", "a/b", "c%230", "c#0", "c#1",
                                                       "5%25", "%317#0", "%317#1", "17th"});
}

TEST_CASE("placements of one instanced node are numbered, those that are skipped too") {
    test::GlbWriter writer;
    const std::string mesh = test::one_triangle_mesh(writer);
    const int at = writer.add_floats({1, 0, 0, 2, 0, 0, 3, 0, 0}, "VEC3", 3);
    const int scale = writer.add_floats({1, 1, 1, 0, 1, 1, 1, 1, 1}, "VEC3", 3);
    const std::string instanced =
        R"({"name":"fern","mesh":0,"extensions":{"EXT_mesh_gpu_instancing":{"attributes":
           {"TRANSLATION":)" +
        std::to_string(at) + ",\"SCALE\":" + std::to_string(scale) + "}}}}";
    const test::Upload upload("scene.glb",
                              writer.glb(mesh + R"(,"nodes":[)" + instanced +
                                         R"(,{"name":"fern","mesh":0},{"name":"rock","mesh":0}])"));
    const auto scene = describe_gltf(upload.request(), ImportLimits{});
    REQUIRE(scene.has_value());
    const auto built = test::build_scene(*scene);
    CHECK(texts_of(*built) == std::vector<std::string>{"fern#0", "fern#2", "fern#3", "rock"});
    CHECK(expand_path(*built, 1)->at(0).node == 0);
    CHECK(expand_path(*built, 2)->at(0).node == 1);
    CHECK(complaint(*built, "fern#1").find("places nothing") != std::string::npos);
}

TEST_CASE("instances of a described scene are numbered as well") {
    SceneDescription description = test::tree_scene();
    description.objects[2].instances[1].name = "first";
    description.objects[2].instances[3].name = "";
    const auto scene = test::build_scene(description);
    CHECK(texts_of(*scene) == std::vector<std::string>{"first#0", "first#0/low", "first#0/leaf",
                                                       "first#1", "first#1/low", "first#1/leaf",
                                                       "lone", "twig", "twig/low", "twig/leaf"});
}

TEST_CASE("the names of nodes and of instances both stay where a scene becomes part of another") {
    SceneDescription description = test::tree_scene();
    description.objects[1].instances[1].name = "low";
    const auto part = read_nodes(equal_subtrees);
    const std::vector<std::string> nodes = texts_of(*part);
    const auto with = [](const std::string& before, std::vector<std::string> texts) {
        for (std::string& text : texts)
            text.insert(0, text.empty() ? before.substr(0, before.size() - 1) : before);
        return texts;
    };
    const auto linked = [](const auto& base, AddedScene added) {
        auto arena = link_scenes(*base, {}, {&added, 1});
        REQUIRE(arena.has_value());
        return *Snapshot::open(std::move(*arena));
    };
    for (const bool has_own : {false, true}) {
        CAPTURE(has_own);
        if (has_own) description.objects[2].geometries.push_back(test::unit_square());
        const auto base = test::build_scene(description);
        std::vector<std::string>
            instances;  // the root's own primitives have the text "", to begin with
        for (std::uint64_t path = 0; path < base->statistics().instances; ++path)
            instances.push_back(text_of(*base, path));
        // The root's own primitives make the base an instance of the new root.
        std::vector<std::string> wanted = has_own ? with("root/", instances) : instances;
        for (const char* copy : {"glb#0/", "glb#1/"})
            std::ranges::copy(with(copy, nodes), std::back_inserter(wanted));
        const auto made =
            linked(base, {part, "glb", {translation(50, 0, 0), translation(60, 0, 0)}, {~0U, ~0U}});
        CHECK(texts_of(*made) == wanted);
        CHECK(expand_path(*made, instances.size() + 2)->at(2).uid == 5);  // the user id of b/p
        wanted = nodes;
        std::ranges::copy(with("woods/", instances), std::back_inserter(wanted));
        CHECK(texts_of(*linked(part, {base, "woods", {translation(50, 0, 0)}, {~0U}})) == wanted);
    }
    description.objects[2].geometries.clear();
    description.objects[2].instances.assign(named_placements_max + 1,
                                            place(0, translation(1, 0, 0)));
    const AddedScene added{part, "glb", {}, {}};
    CHECK_FALSE(nodes_name(*test::build_scene(description), {&added, 1}));
}

TEST_CASE("an unknown path is an error that lists the known names") {
    const auto scene = read_nodes(equal_subtrees);
    CHECK(complaint(*scene, "a/p") == "'a' has no 'p'; there are: x, y");
    CHECK(complaint(*scene, "c") == "the scene has no 'c'; there are: a, b");
    CHECK(complaint(*scene, "a") == "'a' places nothing that can be hit; below it: a/x, a/y");
    CHECK(complaint(*scene, "a/x/") == "'a/x' has no ''");
    for (const char* text : {"", "/", "a//x", "a/x#0", "a/x#", "a#4294967295/x", "#", "a/x#-1"}) {
        complaint(*scene, text);
        CHECK(named_paths(*scene, text).empty());
    }
    const auto twins = read_nodes(R"({"name":"n","mesh":0},{"name":"n","mesh":0})");
    CHECK(complaint(*twins, "n") == "the scene has several 'n': give the number, as 'n#0'");
    CHECK(complaint(*twins, "n#2") == "there is no 'n#2': the last one is 'n#1'");
}

TEST_CASE("a chain of many nodes keeps the end of its text, and costs no more") {
    std::string nodes;
    constexpr int count = 20'000;
    for (int i = 0; i < count; ++i)
        nodes +=
            R"({"name":"link)" + std::to_string(i) + "\"" +
            (i + 1 < count ? ",\"children\":[" + std::to_string(i + 1) + "]}," : ",\"mesh\":0}");
    const auto scene = read_nodes(nodes);
    const auto steps = expand_path(*scene, 0);
    REQUIRE(steps.has_value());
    CHECK(steps->front().name == "...");
    CHECK(steps->back().name == "link19999");
    CHECK(steps->size() <= path_steps_max + 1);
    CHECK(path_name(*steps).size() <= path_text_bytes_max + 4);
}

TEST_CASE("a long name is cut between characters, before encoding lengthens it") {
    const std::string cut = path_step_text(std::string(300, '/'));
    CHECK(cut.size() <= path_step_bytes_max);
    CHECK(cut.size() % 3 == 0);
    CHECK(path_step_text(std::string(300, 'a')) == std::string(path_step_bytes_max, 'a'));
    CHECK(path_step_text("a*b") == "a%2Ab");
    CHECK(path_step_text(std::string(239, 'a') + "\xE6\xA3\xAE").size() <= path_step_bytes_max);
}

TEST_CASE("path nodes that do not fit their scene are refused") {
    SceneDescription scene = test::tree_scene();
    scene.path_nodes = {{0, "", no_id, 0}, {0, "a", 0, 9}};
    scene.placed_nodes = {1};
    CHECK_FALSE(Snapshot::build(scene).has_value());  // the scene has ten placements
    scene.path_nodes[1].placements = 10;
    CHECK(Snapshot::build(scene).has_value());
    scene.placed_nodes = {1, 1};
    CHECK_FALSE(Snapshot::build(scene).has_value());
    scene.placed_nodes = {2};
    CHECK_FALSE(Snapshot::build(scene).has_value());
    scene.placed_nodes = {1};
    scene.path_nodes[1].parent = 1;
    CHECK_FALSE(Snapshot::build(scene).has_value());
}

TEST_CASE("damaged names of paths are refused, or every text stays in range") {
    SceneDescription numbered_scene = test::tree_scene();
    numbered_scene.objects[2].instances[1].name = "first";
    for (const auto& scene : {read_nodes(equal_subtrees), test::build_scene(numbered_scene)}) {
        const std::span<const std::byte> bytes = scene->bytes();
        const auto* header = reinterpret_cast<const format::Header*>(bytes.data());
        const auto first = static_cast<std::size_t>(format::Section::path_nodes);
        int refused = 0;
        for (const std::uint32_t word : {0xFFFFFFFFU, 0x7FFFFFFFU, 7U, 2U, 1U, 0U}) {
            for (std::size_t at = header->sections[first].offset; at < bytes.size(); at += 4) {
                Arena arena(bytes.size());
                std::copy(bytes.begin(), bytes.end(), arena.data());
                std::memcpy(arena.data() + at, &word, 4);
                const auto opened = Snapshot::open({std::move(arena)});
                refused += opened ? 0 : 1;
                for (std::uint64_t path = 0; opened && path < scene->statistics().instances;
                     ++path) {
                    const std::string text = text_of(**opened, path);
                    static_cast<void>(find_path(**opened, text));
                    static_cast<void>(named_paths(**opened, text));
                }
            }
        }
        CHECK(refused >= (scene->paths().node_count != 0 ? 100 : 0));
    }
}
