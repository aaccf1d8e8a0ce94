// Masks by paths: which paths a rule matches, and which placements get its mask.
#include "engine/assets/input/mask_rules.h"

#include "engine/assets/gltf/gltf.h"
#include "engine/scene/snapshot.h"
#include "tests/unit/engine/assets/samples.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <map>
#include <string>
#include <vector>

using namespace raynest;
using Rules = std::vector<std::string>;

namespace {

MaskRules rules_of(const Rules& texts) {
    auto rules = MaskRules::parse(texts);
    REQUIRE_MESSAGE(rules.has_value(), (rules ? "" : rules.error().message));
    return std::move(*rules);
}

/// Returns the mask of a path after step-by-step matching; mask_all if no rule matches.
std::uint32_t mask_of(const Rules& texts, const std::string& path) {
    MaskRules rules = rules_of(texts);
    MaskRules::State state = MaskRules::start();
    for (std::size_t first = 0; first <= path.size();) {
        const std::size_t end = std::min(path.find('/', first), path.size());
        const auto next = rules.step(state, path.substr(first, end - first), first == 0);
        REQUIRE(next.has_value());
        state = *next;
        first = end + 1;
    }
    return rules.mask(state).value_or(mask_all);
}

bool matches(const std::string& glob, const std::string& path) {
    return mask_of({glob + "=5"}, path) == 5;
}

/// Returns by path the mask bits that a request needs: all instances on the path must admit it.
std::map<std::string, std::uint32_t> masks_of(const Snapshot& scene) {
    std::map<std::string, std::uint32_t> masks;
    for (std::uint64_t path = 0; path < scene.statistics().instances; ++path) {
        std::uint32_t mask = mask_all;
        walk_path(scene.view(), path,
                  [&](std::uint32_t instance) { mask &= scene.view().instances[instance].mask; });
        masks[path_name(*expand_path(scene, path))] = mask;
    }
    return masks;
}

SceneDescription describe_nodes(const std::string& nodes, const Rules& rules) {
    test::GlbWriter writer;
    const std::string mesh = test::one_triangle_mesh(writer);
    const test::Upload upload("scene.glb", writer.glb(mesh + ",\"nodes\":[" + nodes + "]"));
    ImportRequest request = upload.request();
    request.masks = rules;
    auto scene = describe_gltf(request, ImportLimits{});
    REQUIRE_MESSAGE(scene.has_value(), (scene ? "" : scene.error().message));
    return std::move(*scene);
}

/// Two equal stands of two trees.
const std::string two_stands =
    R"({"name":"north","children":[2,3]},{"name":"south","translation":[9,0,0],"children":[4,5]},
       {"name":"oak","mesh":0},{"name":"elm","mesh":0,"translation":[0,2,0]},
       {"name":"oak","mesh":0},{"name":"elm","mesh":0,"translation":[0,2,0]})";

}  // namespace

TEST_CASE("a glob matches a whole path, and '*' any text") {
    CHECK(matches("north", "north"));
    CHECK_FALSE(matches("north", "northern"));
    CHECK_FALSE(matches("north", "far/north"));
    CHECK(matches("*", "a/b"));
    CHECK(matches("*oak", "north/oak"));
    CHECK(matches("north*elm", "north/old/elm"));
    CHECK(matches("a*b*c", "axbxbxc"));
    CHECK_FALSE(matches("a*b*c", "axcxb"));
    CHECK(matches("*aab", "aaab"));
    CHECK(matches("*abab", "abaabab"));
    CHECK(matches("*abab*x", "aababab/x"));
    CHECK_FALSE(matches("*ab", "abc"));
    CHECK(matches("n*", "n"));
    CHECK(matches("**", "anything"));
    CHECK(matches("a/*/c", "a/b/c"));
    CHECK_FALSE(matches("a/*/c", "a/c"));
    CHECK(matches("*=x", "a=x"));
}

TEST_CASE("a match holds for all below, and the last rule that matches wins") {
    CHECK(mask_of({"north=1"}, "north/oak/leaf") == 1);
    CHECK(mask_of({"north=1", "*oak=2"}, "north/oak/leaf") == 2);
    CHECK(mask_of({"*oak=2", "north=1"}, "north/oak/leaf") == 1);
    CHECK(mask_of({"*oak=2", "north=1"}, "south/oak/leaf") == 2);
    CHECK(mask_of({"north=0"}, "north") == 0);
    CHECK(mask_of({"north=0xfF"}, "north") == 0xFF);
    CHECK(mask_of({}, "north") == mask_all);
}

TEST_CASE("invalid rules are refused") {
    for (const char* text :
         {"", "=", "=1", "a", "a=", "a=g", "a=100000000", "a=-1", "a=0x", "a=1 "}) {
        CAPTURE(text);
        const auto rules = MaskRules::parse(Rules{text});
        REQUIRE_FALSE(rules.has_value());
        CHECK(rules.error().message.find("is not GLOB=HEX") != std::string::npos);
    }
}

TEST_CASE("too many rules for a scene are an error") {
    const Rules many(1000, "*a*b*c=1");
    MaskRules rules = rules_of(many);
    MaskRules::State state = MaskRules::start();
    for (std::uint64_t i = 0; i < mask_work_max / many.size(); ++i)
        if (auto next = rules.step(state, "", true)) state = *next;
    const auto last = rules.step(state, "x", true);
    REQUIRE_FALSE(last.has_value());
    CHECK(last.error().code == ErrorCode::limit_exceeded);
}

TEST_CASE("equal subtrees with different masks are not shared") {
    const auto plain = test::build_scene(describe_nodes(two_stands, {}));
    CHECK(plain->statistics().levels == 3);
    const auto masked = test::build_scene(describe_nodes(two_stands, {"south=2"}));
    CHECK(masks_of(*masked) == std::map<std::string, std::uint32_t>{{"north/oak", mask_all},
                                                                    {"north/elm", mask_all},
                                                                    {"south/oak", 2},
                                                                    {"south/elm", 2}});
    CHECK(masked->digest() != plain->digest());
    CHECK(masked->statistics().warnings.empty());
}

TEST_CASE("groups have the union of their members' masks") {
    const auto scene = test::build_scene(describe_nodes(two_stands, {"*oak=1", "*elm=4"}));
    REQUIRE(scene->statistics().levels == 3);  // still equal
    const SceneView& view = scene->view();
    const ObjectRecord& root = view.objects[view.root];
    for (std::uint32_t i = 0; i < root.instance_count; ++i)
        CHECK(view.instances[root.first_instance + i].mask == 5);
    CHECK(masks_of(*scene).at("south/elm") == 4);
}

TEST_CASE("a node's own mask applies below it, and rules override it") {
    const std::string own =
        R"({"name":"a","extras":{"raynest":{"mask":6}},"children":[1,2]},{"name":"b","mesh":0},
           {"name":"c","mesh":0,"extras":{"raynest":{"mask":"F0"}}},{"name":"d","mesh":0})";
    CHECK(masks_of(*test::build_scene(describe_nodes(own, {}))) ==
          std::map<std::string, std::uint32_t>{{"a/b", 6}, {"a/c", 0xF0}, {"d", mask_all}});
    CHECK(masks_of(*test::build_scene(describe_nodes(own, {"*c=1"}))) ==
          std::map<std::string, std::uint32_t>{{"a/b", 6}, {"a/c", 1}, {"d", mask_all}});
}

TEST_CASE("invalid masks in extras, and rules that match nothing, cause warnings") {
    for (const std::string mask : {"\"x\"", "1.5", "[1]", "\"123456789\"", "true", "null", "{}",
                                   "-1", "-2", "4294967296", "4294967297", "1e12"}) {
        const auto scene =
            describe_nodes(R"({"mesh":0,"extras":{"raynest":{"mask":)" + mask + "}}}", {});
        CAPTURE(mask);
        REQUIRE(scene.warnings.size() == 1);
        CHECK(scene.warnings[0].find("node 0: extras.raynest.mask is no") == 0);
        CHECK(scene.objects[scene.root].instances[0].mask == mask_all);
    }
    for (const auto& [mask, value] :
         std::map<std::string, std::uint32_t>{{"0", 0},
                                              {"4294967295", mask_all},
                                              {"2147483648", 0x80000000},
                                              {"2.0", 2},
                                              {"3e0", 3}}) {
        const auto scene = describe_nodes(
            R"({"mesh":0},{"mesh":0,"extras":{"raynest":{"mask":)" + mask + "}}}", {});
        CAPTURE(mask);
        CHECK(scene.warnings.empty());
        CHECK(scene.objects[scene.root].instances[0].mask == mask_all);
        CHECK(scene.objects[scene.root].instances[1].mask == value);
    }
    const auto several = describe_nodes(
        R"({"mesh":0,"name":"oak","extras":{"raynest":"x"}},{"mesh":0,"extras":{"raynest":7}})",
        {});
    REQUIRE(several.warnings.size() == 1);
    CHECK(several.warnings[0].find("node 0 ('oak') and 1 other: extras") == 0);
    for (const char* extras : {"1", "[]", "{\"raynest\":{}}", "{\"mask\":1}"})
        CHECK(describe_nodes(R"({"mesh":0,"extras":)" + std::string(extras) + "}", {})
                  .warnings.empty());
    const auto scene = describe_nodes(two_stands, {"west=1", "north=1"});
    REQUIRE(scene.warnings.size() == 1);
    CHECK(scene.warnings[0].find("'west=1' changes nothing") != std::string::npos);
}

TEST_CASE("placements of an instanced node have masks of their own") {
    test::GlbWriter writer;
    const std::string mesh = test::one_triangle_mesh(writer);
    const int at = writer.add_floats({1, 0, 0, 2, 0, 0, 3, 0, 0}, "VEC3", 3);
    const std::string node = R"({"name":"fern","mesh":0,"extensions":{"EXT_mesh_gpu_instancing":
        {"attributes":{"TRANSLATION":)" +
                             std::to_string(at) + "}}}}";
    const test::Upload upload("scene.glb", writer.glb(mesh + ",\"nodes\":[" + node + "]"));
    ImportRequest request = upload.request();
    request.masks = {"fern#1=8"};
    const auto scene = describe_gltf(request, ImportLimits{});
    REQUIRE(scene.has_value());
    CHECK(masks_of(*test::build_scene(*scene)) ==
          std::map<std::string, std::uint32_t>{
              {"fern#0", mask_all}, {"fern#1", 8}, {"fern#2", mask_all}});
}

TEST_CASE("described scenes take rules as well") {
    SceneDescription scene = test::tree_scene();
    MaskRules rules = rules_of({"second/*=2", "third=4", "*/low=8", "lone=1"});
    REQUIRE(apply_masks(rules, scene).has_value());
    CHECK(scene.warnings.empty());
    const auto built = test::build_scene(scene);
    CHECK(built->statistics().instances == 10);
    CHECK(masks_of(*built) == std::map<std::string, std::uint32_t>{{"first", mask_all},
                                                                   {"first/low", 8},
                                                                   {"first/leaf", mask_all},
                                                                   {"second", mask_all},
                                                                   {"second/low", 8},
                                                                   {"second/leaf", 2},
                                                                   {"lone", 1},
                                                                   {"third/twig", 4},
                                                                   {"third/low", 8},
                                                                   {"third/leaf", 4}});
}

TEST_CASE("rules that settle early copy nothing") {
    SceneDescription scene = test::tree_scene();
    MaskRules rules = rules_of({"second*=2"});
    REQUIRE(apply_masks(rules, scene).has_value());
    CHECK(scene.objects.size() == 4);  // includes a copy of the root
    CHECK(masks_of(*test::build_scene(scene)).at("second/low") == 2);
}

TEST_CASE("a star alone applies to the root's own primitives too") {
    SceneDescription scene;
    scene.objects.resize(1);
    scene.objects[0].geometries = {test::unit_square()};
    MaskRules rules = rules_of({"lone=1", "*=2"});
    REQUIRE(apply_masks(rules, scene).has_value());
    REQUIRE(scene.warnings.size() == 1);
    CHECK(scene.warnings[0].find("'lone=1'") != std::string::npos);
    const auto masks = masks_of(*test::build_scene(scene));
    REQUIRE(masks.size() == 1);
    CHECK(masks.begin()->second == 2);
}
