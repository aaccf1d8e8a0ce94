// Reads hostile compositions: the text as given, beside a .npy of places and a scene of one
// triangle in place of each file.
#include "engine/assets/composition/compose.h"
#include "tests/fuzz/target.h"

#include <string>
#include <string_view>

using namespace raynest;

namespace {

fuzz::Input seed(std::string_view text) {
    return {text.begin(), text.end()};
}

/// Two offsets, (2, 3) float32.
std::string places() {
    std::string header = "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3), }";
    header.resize(117, ' ');
    return std::string("\x93NUMPY\1\0\x76\0", 10) + header + "\n" + std::string(24, '\1');
}

Result<BuiltArena> import_triangle(const ImportRequest&) {
    SceneDescription scene;
    ObjectDescription& object = scene.objects.emplace_back();
    object.name = "triangle";
    object.geometries.emplace_back();
    object.geometries[0].positions = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
    object.geometries[0].indices = {0, 1, 2};
    return build_arena(scene);
}

}  // namespace

std::vector<fuzz::Input> fuzz::seeds() {
    return {
        seed(
            R"({"rnscene": 1, "objects": {"a": {"file": "a.obj"}}, "instances": [{"object": "a"}]})"),
        seed(R"({"rnscene": 1, "origin": [1, 2, 3], "objects": {"g": {"instances": [{"object": "a",
             "matrices": "m.npy", "mask": "0x2", "uid": 7}]}, "a": {"file": "builtin:flake", "origin": "auto",
             "unit": 2, "up": "z", "radius": 1, "spacing": 2, "primitive": "sphere", "masks": ["a=1"]}},
             "instances": [{"object": "g", "translation": [1, 2, 3], "rotation": [0, 1, 0, 1], "scale": [1, 2, 3]},
             {"object": "g", "name": "x", "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]},
             {"object": "a", "matrices": [[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 5]]]}],
             "cameras": [{"name": "c", "eye": [0, 1, 2], "target": [3, 4, 5], "up": [0, 0, 1], "fov": 30}]})"),
        seed(
            R"({"rnscene": 1, "up": "z", "objects": {"a": {"file": "a.obj"}, "b": {"file": "a.obj", "up": "y"}},
             "instances": [{"object": "a", "matrices": "m.npy"}, {"object": "b"}],
             "lights": [{"type": "spot", "position": [0, 8, 0], "direction": [0, -1, 0], "inner": 1, "outer": 60}],
             "edits": [{"move": "a*", "translation": [1, 2, 3], "scale": 2}, {"set-mask": "a#0", "mask": "0x2"},
             {"turn": "b", "matrix": [0, 0, 1, 0, 0, 1, 0, 0, -1, 0, 0, 0]}, {"set-uid": "b", "uid": 7},
             {"hide": "b"}, {"place": "a#1", "rotation": [0, 1, 0, 1]}, {"remove": "a#2"}, {"show": "*"}]})"),
        seed(
            R"({"rnscene": 1, "objects": {"a": {"file": "x.rnscene.json"}, "b": {"instances": [{"object": "b"}]}},
             "instances": [{"object": "b"}, {"object": "a"}]})"),
    };
}

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    const std::string table = places();
    constexpr std::string_view obj = "v 0 0 0\n";
    ImportRequest request;
    request.source = "x.rnscene.json";
    request.files = {{request.source, std::as_bytes(std::span(data, size))},
                     {"m.npy", std::as_bytes(std::span(table))},
                     {"a.obj", std::as_bytes(std::span(obj))}};
    ImportLimits limits;
    limits.nodes_max = 1000;
    limits.json_bytes_max = 1 << 20;
    const auto made = compose(request, limits, import_triangle);
    if (made) return 0;
    fuzz::require(!made.error().message.empty() &&
                  made.error().message.find('\n') == std::string::npos);
    return 0;
}
