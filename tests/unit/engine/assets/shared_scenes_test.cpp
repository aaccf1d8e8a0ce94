// The shared scenes: good ones load with the right counts, hostile ones end in one line.
#include "engine/assets/import.h"
#include "tests/unit/engine/assets/samples.h"
#include "tests/unit/engine/builtin_packs.h"

#include <nlohmann/json.hpp>

#include <cstdlib>
#include <map>
#include <set>

using namespace raynest;
using test::registry;
namespace fs = std::filesystem;

namespace {

/// Imports a file, which must end in a scene or in one readable line. True for a scene.
bool loads(const ImportRequest& request) {
    const auto scene = import_here(request, ImportLimits{}, registry());
    if (scene) return true;
    const std::string& message = scene.error().message;
    CAPTURE(message);
    CHECK(scene.error().code != ErrorCode::internal);
    CHECK(message.size() > 10);
    CHECK(message.size() < 400);
    for (const char c : message) CHECK(static_cast<unsigned char>(c) >= 0x20);
    return false;
}

std::uint64_t skipped(const SceneStatistics& statistics, const char* reason) {
    const auto found = statistics.skipped.find(reason);
    return found == statistics.skipped.end() ? 0 : found->second;
}

/// The unpacked terrain, in a temporary folder of its own.
class Terrain {
public:
    Terrain() : folder_(fs::temp_directory_path() / "raynest-terrain-test") {
        fs::create_directories(folder_);
        const std::string command = "xz -dc '" + test::shared_scene("terrain_2M.glb.xz").string() +
                                    "' > '" + path().string() + "'";
        unpacked_ = std::system(command.c_str()) == 0;
    }
    Terrain(const Terrain&) = delete;
    ~Terrain() { fs::remove_all(folder_); }
    [[nodiscard]] fs::path path() const { return folder_ / "terrain_2M.glb"; }
    [[nodiscard]] bool unpacked() const { return unpacked_; }

private:
    fs::path folder_;
    bool unpacked_ = false;
};

}  // namespace

TEST_SUITE_BEGIN("shared scenes");

TEST_CASE("loaded and skipped counts of every shared scene add up to what is expected") {
    if (!test::have_shared_scenes()) return;
    const Terrain terrain;
    std::ifstream file(test::shared_scene("expected.json"));
    const auto expected = nlohmann::json::parse(file);
    for (const auto& [name, counts] : expected.items()) {
        CAPTURE(name);
        fs::path path = test::shared_scene(name);
        if (name == "terrain_2M.glb") {
            if (!terrain.unpacked()) MESSAGE("skipped: terrain_2M.glb, no xz here");
            if (!terrain.unpacked()) continue;
            path = terrain.path();
        }
        const test::Upload upload(path);
        const auto scene = import_here(upload.request(), ImportLimits{}, registry());
        REQUIRE_MESSAGE(scene.has_value(), (scene ? "" : scene.error().message));
        const SceneStatistics& s = (*scene)->statistics();
        CHECK(s.instances + skipped(s, "singular_instances") == counts["mesh_instances"]);
        CHECK(s.instanced_triangles + skipped(s, "singular_instance_triangles") ==
              counts["instanced_triangles"]);
        CHECK(s.unique_triangles <= counts["unique_triangles"]);
        CHECK(s.mask_materials == counts["mask_materials"]);
        CHECK((counts["cameras"] == 0) == s.cameras.empty());
        CHECK((skipped(s, "textures") == 0 || !images_available()));
    }
}

TEST_CASE("temple.glb loses exactly its singular node") {
    if (!test::have_shared_scenes()) return;
    const test::Upload upload(test::shared_scene("temple.glb"));
    const auto scene = import_here(upload.request(), ImportLimits{}, registry());
    REQUIRE(scene.has_value());
    const SceneStatistics& s = (*scene)->statistics();
    CHECK(s.instances == 1617);
    CHECK(s.instanced_triangles == 205'766);
    CHECK(skipped(s, "singular_instances") == 1);
    CHECK(skipped(s, "singular_instance_triangles") == 684);
}

TEST_CASE("the temple as nodes and as EXT_mesh_gpu_instancing is the same scene") {
    if (!test::have_shared_scenes()) return;
    const auto statistics = [](const char* name) {
        const test::Upload upload(test::shared_scene(name));
        const auto scene = import_here(upload.request(), ImportLimits{}, registry());
        REQUIRE(scene.has_value());
        return (*scene)->statistics();
    };
    const SceneStatistics nodes = statistics("cocoa_temple.glb");
    const SceneStatistics instanced = statistics("cocoa_temple_gpuinst.glb");
    CHECK(nodes.instances == instanced.instances);
    CHECK(nodes.unique_triangles == instanced.unique_triangles);
    CHECK(nodes.instanced_triangles == instanced.instanced_triangles);
    CHECK(nodes.cameras == instanced.cameras);
    // Its library items hold several meshes each: sharing them adds a level.
    CHECK(nodes.levels == 3);
    CHECK(instanced.levels == 2);
}

TEST_CASE("paths of the temples have texts of their own, which find them again") {
    if (!test::have_shared_scenes()) return;
    for (const char* name : {"cocoa_temple.glb", "temple.glb", "cocoa_temple_gpuinst.glb"}) {
        CAPTURE(name);
        const test::Upload upload(test::shared_scene(name));
        const auto scene = import_here(upload.request(), ImportLimits{}, registry());
        REQUIRE(scene.has_value());
        std::set<std::string> texts;
        for (std::uint64_t path = 0; path < (*scene)->statistics().instances; ++path) {
            const auto steps = expand_path(**scene, path);
            REQUIRE(steps.has_value());
            const std::string text = path_name(*steps);
            CHECK(texts.insert(text).second);
            const auto found = find_path(**scene, text);
            REQUIRE(found.has_value());
            CHECK(*found == path);
        }
    }
}

TEST_CASE("every hostile file ends in one line or in a scene, in time") {
    if (!test::have_shared_scenes()) return;
    std::map<std::string, bool> results;
    for (const auto& entry : fs::recursive_directory_iterator(test::shared_scene("hostile"))) {
        const fs::path extension = entry.path().extension();
        if (!entry.is_regular_file() || (extension != ".gltf" && extension != ".glb")) continue;
        CAPTURE(entry.path().string());
        const bool crafted = entry.path().parent_path().filename() == "hostile";
        const bool loaded = loads(test::Upload(entry.path()).request());
        if (crafted) results[entry.path().stem().string()] = loaded;
    }
    CHECK(results.size() >= 90);
    // Each family must be refused according to ../shared/notes, except these. Zeros without a
    // bufferView, an unused second buffer and a choice of a missing scene are harmless.
    const auto may_load = [](const std::string& name) {
        for (const char* prefix :
             {"00_valid", "mode_1", "mode_2", "mode_4", "mode_5", "img_", "json_bom", "no_scenes",
              "acc_no_bv_attr", "glb_2nd_buffer_nouri", "scene_default_oob", "node_matrix_singular",
              "node_rot_nonunit", "tri_zero_area", "mat_alphamode_weird"}) {
            if (name.starts_with(prefix)) return true;
        }
        return false;
    };
    for (const auto& [name, loaded] : results) {
        CAPTURE(name);
        CHECK((may_load(name) || !loaded));
    }
    for (const char* good : {"00_valid", "mode_4", "mode_5", "json_bom", "node_rot_nonunit",
                             "acc_no_bv_attr", "glb_2nd_buffer_nouri", "scene_default_oob"})
        CHECK(results[good]);
}

TEST_CASE("good scenes cut at 200 places end in one line or in a scene") {
    if (!test::have_shared_scenes()) return;
    for (const char* name :
         {"small/AlphaBlendModeTest.glb", "small/simple-instancing.glb",
          "small/blender_alpha_mask/01_alpha_mask.gltf",
          "small/blender_gpu_instancing/24_gpu_instancing.gltf", "small/many-cubes/many-cubes.gltf",
          "temple.glb", "cocoa_temple.glb"}) {
        CAPTURE(name);
        const test::Upload upload(test::shared_scene(name));
        const std::size_t size = upload.request().files[0].bytes.size();
        for (std::size_t i = 0; i < 200; ++i) {
            // Half of the cuts fall into the first 4 KB, which hold the structure.
            const std::size_t at =
                i < 100 ? i * std::min<std::size_t>(size, 4096) / 100 : (i - 100) * size / 100;
            CAPTURE(at);
            CHECK_FALSE(loads(upload.cut(at)));
        }
    }
}

TEST_SUITE_END();
