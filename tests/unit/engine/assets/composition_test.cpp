// Compositions and the axis that points up, as an import sees them: files in, a snapshot out.
#include "engine/assets/composition/read.h"
#include "engine/assets/gltf/write/glb_file.h"
#include "engine/assets/import.h"
#include "engine/scene/edits/pose.h"
#include "tests/unit/engine/assets/samples.h"

#include <ctime>
#include <map>
#include <memory>
#include <string>

using namespace raynest;

namespace {

/// One unit along x, two along y, four along z.
const std::string corner_file =
    "o corner\nv 0 0 0\nv 1 0 0\nv 0 2 0\nv 0 0 4\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n";
const Box on_map{{0, 0, 0}, {1, 2, 4}};    // +Z up
const Box upright{{0, 0, -2}, {1, 4, 0}};  // the same with +Y up

double processor_seconds() {
    timespec now{};
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
    return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

using Texts = std::map<std::string, std::string>;

Result<std::shared_ptr<const Snapshot>> import(const std::string& source, const Texts& texts,
                                               FileOptions options = {}) {
    static const auto registry = Registry::load({});
    std::vector<test::Bytes> kept;
    for (const auto& [name, text] : texts) kept.push_back(test::to_bytes(text));
    ImportRequest request;
    request.source = source;
    request.options = options;
    std::size_t i = 0;
    for (const auto& [name, text] : texts) {
        const NamedBytes file{name, kept[i++]};
        request.files.insert(name == source ? request.files.begin() : request.files.end(), file);
    }
    return import_here(request, ImportLimits{}, **registry);
}

std::shared_ptr<const Snapshot> must_import(const std::string& source, const Texts& texts,
                                            FileOptions options = {}) {
    auto scene = import(source, texts, options);
    REQUIRE_MESSAGE(scene.has_value(), (scene ? "" : scene.error().message));
    return *scene;
}

/// Imports a composition beside the file "a.obj".
std::shared_ptr<const Snapshot> compose(const std::string& members, Texts beside = {}) {
    beside["a.obj"] = corner_file;
    beside["x.rnscene.json"] = "{\"rnscene\": 1, " + members + "}";
    return must_import("x.rnscene.json", beside);
}

bool same(const Box& a, const Box& b) {
    return a.lower == b.lower && a.upper == b.upper;
}

std::string exported(const Snapshot& scene) {
    const auto file = gltf::GlbFile::make(scene, [] { return false; });
    REQUIRE(file.has_value());
    std::string text(file->bytes(), '\0');
    file->read(0, std::as_writable_bytes(std::span(text)));
    return text;
}

}  // namespace

TEST_CASE("a file with +Z up keeps its coordinates, and the scene says so") {
    const auto scene = must_import("a.obj", {{"a.obj", corner_file}}, {.z_up = true});
    CHECK(scene->up() == UpAxis::z);
    CHECK(same(scene->bounds(), on_map));
    const auto plain = must_import("a.obj", {{"a.obj", corner_file}});
    CHECK(plain->up() == UpAxis::y);
    CHECK(same(plain->bounds(), on_map));
    CHECK(plain->digest() != scene->digest());
    const auto builtin = import("builtin:flake?depth=1", {}, {.z_up = true});
    REQUIRE_FALSE(builtin.has_value());
    CHECK(builtin.error().message.find("leave out `up`") != std::string::npos);
}

TEST_CASE("an export with +Z up is upright glTF, and comes back as it was") {
    for (const std::string name : {"o corner", "o left"}) {
        std::string two = corner_file;
        two.replace(0, 8, name);
        const auto scene = must_import("a.obj", {{"a.obj", two}}, {.z_up = true});
        const std::string glb = exported(*scene);
        const auto back = must_import("b.glb", {{"b.glb", glb}});
        CHECK(back->up() == UpAxis::z);
        CHECK(same(back->bounds(), on_map));
        CHECK(exported(*back) == glb);
        std::string foreign = glb;
        const std::size_t word = foreign.find("\"raynest\"");
        REQUIRE(word != std::string::npos);
        foreign.replace(word, 9, "\"strange\"");
        const auto other = must_import("b.glb", {{"b.glb", foreign}});
        CHECK(other->up() == UpAxis::y);
        CHECK(same(other->bounds(), upright));
        CHECK(gltf::composition_text(*scene, "b.glb").find("\"up\": \"z\"") != std::string::npos);
        CHECK(gltf::composition_text(*other, "b.glb").find("\"up\"") == std::string::npos);
    }
}

TEST_CASE("an export takes no more memory than it said, and ends when nobody needs it") {
    // JSON spells each byte of such a name in six.
    const auto scene_of = [](int count, const std::string& name) {
        std::string text = R"({"rnscene": 1, "objects": {"a": {"file": "a.obj"}}, "instances": [)";
        text += R"({"object": "a", "name": ")" + name + R"(", "matrices": [)";
        for (int i = 0; i < count; ++i)
            text += (i == 0 ? "[1,0,0," : ",[1,0,0,") + std::to_string(i) + ",0,1,0,0,0,0,1,0]";
        return must_import("c.rnscene.json",
                           {{"c.rnscene.json", text + "]}]}"}, {"a.obj", corner_file}});
    };
    std::string name;
    for (int i = 0; i < 30; ++i) name += "\\u0001";
    for (const auto& scene : {scene_of(3000, name), scene_of(3000, "a")})
        CHECK(*gltf::GlbFile::memory_max(*scene) >= exported(*scene).size());

    const auto scene = scene_of(50'000, name + name + name + name + name + name + name + name);
    int looks = 0;
    CHECK(!gltf::GlbFile::make(*scene, [&] { return ++looks > 100; }));
    CHECK(looks < 110);
    const auto file = gltf::GlbFile::make(*scene, [] { return false; });
    REQUIRE(!file);
    CHECK(file.error().message.find("more than 64 MiB of JSON") != std::string::npos);
}

TEST_CASE("a composition turns what has another axis up") {
    const std::string one = R"("instances": [{"object": "a"}], "objects": {"a": )";
    const auto glb = exported(*must_import("a.obj", {{"a.obj", corner_file}}, {.z_up = true}));
    const std::string inner = R"({"rnscene": 1, "up": "z", )" + one + R"({"file": "a.obj"}}})";
    for (const auto& [members, up, box] : std::vector<std::tuple<std::string, UpAxis, Box>>{
             {one + R"({"file": "a.obj"}}, "up": "z")", UpAxis::z, on_map},
             {one + R"({"file": "a.obj", "up": "z"}}, "up": "z")", UpAxis::z, on_map},
             {one + R"({"file": "a.obj", "up": "z"}})", UpAxis::y, upright},
             {one + R"({"file": "a.obj"}})", UpAxis::y, on_map},
             {one + R"({"file": "b.glb"}})", UpAxis::y, upright},
             {one + R"({"file": "b.glb"}}, "up": "z")", UpAxis::z, on_map},
             {one + R"({"file": "c.rnscene.json"}})", UpAxis::y, upright},
             {one + R"({"file": "c.rnscene.json"}}, "up": "z")", UpAxis::z, on_map},
             {R"("up": "z", "instances": [{"object": "g"}], "objects": {"a": {"file": "a.obj"},
              "g": {"instances": [{"object": "a"}]}})",
              UpAxis::z, on_map}}) {
        CAPTURE(members);
        const auto scene = compose(members, {{"b.glb", glb}, {"c.rnscene.json", inner}});
        CHECK(scene->up() == up);
        CHECK(same(scene->bounds(), box));
    }
}

TEST_CASE("a file whose coordinates are less an offset stands where the composition says") {
    const auto scene = compose(
        R"("origin": [5e6, 0, 0], "objects": {"a": {"file": "a.obj", "at": [5000003, 7, 0]}},
           "instances": [{"object": "a"}])");
    CHECK(scene->bounds().lower == Vec3(3, 7, 0));
    CHECK(scene->bounds().upper == Vec3(4, 9, 4));
    const auto fails = [](const std::string& object) {
        const auto bad = import(
            "x.rnscene.json", {{"a.obj", corner_file},
                               {"x.rnscene.json", R"({"rnscene": 1, "objects": {"a": {)" + object +
                                                      R"(}}, "instances": [{"object": "a"}]})"}});
        REQUIRE_FALSE(bad);
        return bad.error().message;
    };
    CHECK(fails(R"("file": "a.obj", "at": [1, 0, 0], "origin": [1, 0, 0])")
              .find("give one of the two") != std::string::npos);
    CHECK(fails(R"("file": "a.obj", "at": [1e16, 0, 0])").find("beyond 1e15") != std::string::npos);
    CHECK(fails(R"("file": "x.rnscene.json", "at": [1, 0, 0])").find("says itself") !=
          std::string::npos);
}

TEST_CASE("edits change what the instances of a composition placed, in their order") {
    const std::string town =
        R"("objects": {"a": {"file": "a.obj"}}, "instances": [{"object": "a", "name": "one"},
        {"object": "a", "name": "two", "translation": [10, 0, 0]},
        {"object": "a", "name": "three", "translation": [20, 0, 0]}], "edits": [)";
    const auto plain = compose(town + "]");
    CHECK(same(plain->bounds(), {{0, 0, 0}, {21, 2, 4}}));
    const auto moved = compose(
        town +
        R"({"move": "t*", "translation": [0, 0, 5]}, {"move": "two", "translation": [0, 0, 1]},
        {"set-mask": "*", "mask": "0xF0"}, {"hide": "one"}, {"set-uid": "three", "uid": 7},
        {"place": "one", "translation": [-5, 0, 0], "scale": 2}])");
    const SceneView& view = moved->view();
    const ObjectRecord& root = view.objects[view.root];
    REQUIRE(root.instance_count == 3);
    const auto z = [&](std::uint32_t i) {
        return view.instance_infos[root.first_instance + i].to_parent.m[11];
    };
    CHECK(z(1) == 6);
    CHECK(z(2) == 5);
    CHECK(view.instance_infos[root.first_instance].to_parent.m[0] == 2);
    CHECK(view.instance_infos[root.first_instance].to_parent.m[3] == -5);
    CHECK(view.instances[root.first_instance].mask == 0);
    CHECK(view.instances[root.first_instance + 1].mask == 0xF0);
    CHECK(view.instance_infos[root.first_instance + 2].uid == 7);
    CHECK(moved->statistics().edits.refits == 0);
    const auto fewer = compose(town + R"({"remove": "three"}])");
    CHECK(same(fewer->bounds(), {{0, 0, 0}, {11, 2, 4}}));
    CHECK(compose(town + R"({"remove": "three"}])")->digest() == fewer->digest());
    for (const auto& [edit, said] :
         Texts{{R"({"move": "one"})", "edits[0] is to have 'matrix', or 'translation'"},
               {R"({"hide": "one", "mask": 1})", "edits[0] is to have nothing beside 'hide'"},
               {R"({"hide": "one", "show": "one"})", "edits[0] is to have one of move"},
               {R"({"fly": "one"})", "'fly', which is none of"},
               {R"({"hide": "four"})", "edits[0]: "},
               {R"({"move": "one", "matrix": [0,0,0,0, 0,0,0,0, 0,0,0,0]})", "its edits: "}}) {
        CAPTURE(edit);
        const auto refused = import(
            "x.rnscene.json",
            {{"a.obj", corner_file}, {"x.rnscene.json", "{\"rnscene\": 1, " + town + edit + "]}"}});
        REQUIRE_FALSE(refused.has_value());
        CHECK(refused.error().code == ErrorCode::scene_invalid);
        CHECK(refused.error().message.find(said) != std::string::npos);
    }
}

TEST_CASE("a composition's animations move its instances, and say what they cannot") {
    const std::string objects =
        R"("objects": {"a": {"file": "a.obj"}, "pair": {"instances": [{"object": "a"}]}}, )"
        R"("instances": [{"object": "a", "name": "one", "scale": 2}, )"
        R"({"object": "pair", "name": "two", "translation": [5, 0, 0]}, )"
        R"({"object": "a", "name": "many", "translation": [0, 0, 1]}, )"
        R"({"object": "a", "name": "many", "translation": [0, 0, 2]}, )"
        R"({"object": "a", "name": "fixed", "matrix": [1,0,0,0, 0,1,0,0, 0,0,1,9]}], )";
    const auto imported = [&](const std::string& animations, const std::string& more = "") {
        return import("x.rnscene.json",
                      {{"a.obj", corner_file},
                       {"x.rnscene.json", "{\"rnscene\": 1, " + more + objects +
                                              "\"animations\": [" + animations + "]}"}});
    };
    const std::string drive =
        R"({"name": "drive", "channels": [)"
        R"({"instance": "two", "path": "translation", "times": [0, 4], "values": [[5,0,0],[9,0,0]]},)"
        R"({"instance": "one", "path": "scale", "times": [1, 2], "values": [2, 3]},)"
        R"({"instance": "many#1", "path": "rotation", "times": [0], "values": [[0,0,0,1]],)"
        R"( "interpolation": "step"}]})";
    for (const std::string origin : {"", R"("origin": [100, 0, 0], )"}) {
        CAPTURE(origin);
        const auto scene = imported(drive, origin);
        REQUIRE(scene.has_value());
        const auto motion = checked_motion((*scene)->motion_bytes());
        REQUIRE(motion.animations.size() == 1);
        CHECK(name_of(motion, motion.animations[0]) == "drive");
        CHECK(motion.animations[0].seconds == 4);
        const auto moment = find_moment(**scene, "drive", 2);
        REQUIRE(moment.has_value());
        const auto posed = pose(**scene, *moment);
        REQUIRE(posed.has_value());
        const auto at = [](const Snapshot& of, std::uint32_t place) {
            const SceneView& view = of.view();
            return view.instance_infos[view.objects[view.root].first_instance + place].to_parent.m;
        };
        const float shift = origin.empty() ? 0 : -100;
        CHECK(at(**scene, 1)[3] == 5 + shift);
        CHECK(at(**posed, 1)[3] == 7 + shift);
        CHECK(at(**posed, 0)[0] == 3);
        CHECK(at(**posed, 3)[11] == 2);
        CHECK(at(**posed, 4)[11] == 9);
    }
    const auto channel = [](const std::string& text) { return "{\"channels\": [{" + text + "}]}"; };
    const std::string keys = R"(, "path": "translation", "times": [0], "values": [[0,0,0]])";
    for (const auto& [animation, said] : Texts{
             {channel("\"instance\": \"three\"" + keys), "none of its instances"},
             {channel("\"instance\": \"many\"" + keys), "stands at several places"},
             {channel("\"instance\": \"many#2\"" + keys), "none of its instances"},
             {channel("\"instance\": \"two/a\"" + keys), "none of its instances"},
             {channel("\"instance\": \"fixed\"" + keys), "which a matrix places"},
             {channel(R"("instance": "one", "path": "weights", "times": [0], "values": [1])"),
              "is none of translation, rotation, scale"},
             {channel(R"("instance": "one", "path": "scale", "times": [1, 1], "values": [1, 1])"),
              "is not behind the time before it"},
             {channel(R"("instance": "one", "path": "scale", "times": [-1], "values": [1])"),
              "is no time from 0"},
             {channel(R"("instance": "one", "path": "scale", "times": [0], "values": [0])"),
              "is flat"},
             {channel(
                  R"("instance": "one", "path": "rotation", "times": [0], "values": [[0,0,0,0]])"),
              "length 0"},
             {channel(R"("instance": "one", "path": "scale", "times": [0, 1], "values": [1])"),
              "2 times and 1 values"},
             {channel(R"("instance": "one", "path": "scale", "times": [], "values": [])"),
              "at least one time"},
             {channel(R"("instance": "one", "path": "scale", "times": [0], "values": [1e39])"),
              "does not fit"},
             {R"({"channels": []})", "moves nothing"}}) {
        CAPTURE(animation);
        const auto refused = imported(animation);
        REQUIRE_FALSE(refused.has_value());
        CHECK(refused.error().code == ErrorCode::scene_invalid);
        CHECK(refused.error().message.find(said) != std::string::npos);
    }
}

TEST_CASE("a composition of eight times as many objects takes about eight times as long") {
    const auto time_of = [](int count) {
        std::string objects, instances;
        for (int i = 0; i < count; ++i) {
            const std::string name = "\"o" + std::to_string(i) + "\"";
            const char* const comma = i == 0 ? "" : ",";
            objects += comma + name + ": {\"file\": \"a.obj\"}";
            instances += comma + std::string("{\"object\": ") + name + "}";
        }
        const std::string text =
            "{\"rnscene\": 1, \"objects\": {" + objects + "}, \"instances\": [" + instances + "]}";
        const double began = processor_seconds();
        REQUIRE(composition::read(text, {}));
        return processor_seconds() - began;
    };
    time_of(1000);
    const double few = time_of(3000), many = time_of(24000);
    CHECK(many < 24 * few);  // 64 times, if each looked at all others
}
