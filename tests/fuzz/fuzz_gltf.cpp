// Imports a hostile scene file, a GLB or a single .gltf: it is described, or refused with a
// message.
#include "engine/assets/gltf/gltf.h"
#include "engine/scene/checks/shading_check.h"
#include "engine/scene/motion/motion.h"
#include "tests/fuzz/target.h"

#include <cstring>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>

using namespace raynest;

namespace {

std::string read(const std::filesystem::path& path) {
    std::ifstream file(path, std::ios::binary);
    std::ostringstream bytes;
    bytes << file.rdbuf();
    return bytes.str();
}

std::string word(std::size_t value) {
    std::string bytes(4, '\0');
    const auto narrow = static_cast<std::uint32_t>(value);
    std::memcpy(bytes.data(), &narrow, 4);
    return bytes;
}

std::string glb(const std::string& json, const std::string& binary) {
    return "glTF" + word(2) + word(28 + json.size() + binary.size()) + word(json.size()) + "JSON" +
           json + word(binary.size()) + std::string("BIN\0", 4) + binary;
}

/// Returns a skinned, morphed triangle; one vertex buffer serves as every attribute.
std::string deformed_triangle() {
    std::string floats(144, '\0');
    for (std::size_t i = 0; i < 36; ++i) {
        const float value = static_cast<float>(i % 5) / 4;
        std::memcpy(floats.data() + 4 * i, &value, 4);
    }
    return glb(R"({"asset":{"version":"2.0"},"buffers":[{"byteLength":144}],
        "bufferViews":[{"buffer":0,"byteLength":144}],"accessors":[
        {"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"},
        {"bufferView":0,"byteOffset":8,"componentType":5121,"count":3,"type":"VEC4"},
        {"bufferView":0,"componentType":5126,"count":3,"type":"VEC4"},
        {"bufferView":0,"componentType":5126,"count":2,"type":"MAT4"},
        {"bufferView":0,"componentType":5126,"count":2,"type":"SCALAR"},
        {"bufferView":0,"componentType":5126,"count":2,"type":"VEC4"},
        {"bufferView":0,"componentType":5126,"count":6,"type":"VEC3"}],
        "animations":[{"samplers":[{"input":4,"output":5},{"input":4,"output":6,
        "interpolation":"CUBICSPLINE"},{"input":4,"output":4,"interpolation":"STEP"}],
        "channels":[{"sampler":0,"target":{"node":1,"path":"rotation"}},{"sampler":1,
        "target":{"node":2,"path":"scale"}},{"sampler":2,"target":{"node":3,"path":"weights"}}]}],
        "meshes":[{"weights":[0.5],"primitives":[{"attributes":{"POSITION":0,"JOINTS_0":1,
        "WEIGHTS_0":2},"targets":[{"POSITION":0}]}]}],
        "skins":[{"joints":[1,2],"inverseBindMatrices":3}],
        "nodes":[{"mesh":0,"skin":0,"children":[1]},{"translation":[0,1,0],"children":[2]},
        {"rotation":[0,0,0.6,0.8]},{"mesh":0,"skin":0,"weights":[1]}]})",
               floats);
}

/// Returns a triangle with variants, whose material has all layers and their textures.
std::string layered_triangle() {
    return glb(R"({"asset":{"version":"2.0"},"buffers":[{"byteLength":36}],
        "bufferViews":[{"buffer":0,"byteLength":36}],"accessors":[
        {"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"}],
        "textures":[{"source":0}],"images":[{"bufferView":0,"mimeType":"image/png"}],
        "materials":[{"extensions":{
        "KHR_materials_clearcoat":{"clearcoatFactor":1,"clearcoatRoughnessFactor":0.5,
        "clearcoatNormalTexture":{"index":0,"scale":2,"texCoord":1}},
        "KHR_materials_sheen":{"sheenColorFactor":[1,0.5,0],"sheenRoughnessTexture":{"index":0}},
        "KHR_materials_specular":{"specularFactor":0.5,"specularColorFactor":[2,1,0]},
        "KHR_materials_iridescence":{"iridescenceFactor":1,"iridescenceThicknessMaximum":500},
        "KHR_materials_anisotropy":{"anisotropyStrength":0.5,"anisotropyTexture":{"index":0,
        "extensions":{"KHR_texture_transform":{"scale":[2,3],"rotation":1}}}}}},{}],
        "extensions":{"KHR_materials_variants":{"variants":[{"name":"a"},{"name":"b"}]}},
        "meshes":[{"primitives":[{"attributes":{"POSITION":0},"material":0,"extensions":{
        "KHR_materials_variants":{"mappings":[{"material":1,"variants":[1]}]}}}]}],
        "nodes":[{"mesh":0}]})",
               std::string(36, '\0'));
}

}  // namespace

std::vector<fuzz::Input> fuzz::seeds() {
    std::vector<std::string> files{deformed_triangle(), layered_triangle()};
    const std::filesystem::path odd = std::filesystem::path(RAYNEST_SHARED_SCENES) / "odd";
    if (std::filesystem::exists(odd)) {
        for (const char* name :
             {"box_meshopt.glb", "morph_weight_1.glb", "skin_joint_x5_node_x100.glb",
              "specular_glossiness_alpha.glb", "simple_skin.gltf"}) {
            files.push_back(read(odd / name));
        }
        std::string draco = read(odd / "box_draco.gltf");
        if (const auto uri = draco.find("\"uri\""); uri != std::string::npos)
            draco.replace(uri, 5, "\"was\"");
        files.push_back(glb(draco, read(odd / "0.bin")));
    }
    std::vector<Input> seeds;
    for (const std::string& file : files) seeds.emplace_back(file.begin(), file.end());
    return seeds;
}

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    if (size == 0) return 0;  // describe() refuses it earlier
    const auto bytes = std::span(reinterpret_cast<const std::byte*>(data), size);
    const bool is_glb = size >= 4 && std::memcmp(data, "glTF", 4) == 0;
    ImportRequest request;
    request.source = is_glb ? "scene.glb" : "scene.gltf";
    request.files.push_back({request.source, bytes});
    ImportLimits limits;
    limits.triangles_max = 1 << 20;
    limits.instances_max = 1 << 20;
    limits.nodes_max = 1 << 16;
    if (size % 2 != 0) request.variant = std::string("b");
    const auto scene = describe_gltf(request, limits);
    if (!scene) fuzz::require(!scene.error().message.empty());
    for (std::size_t i = 0; scene && i < scene->materials.size(); ++i)
        fuzz::require(is_sound(scene->materials[i].surface, scene->textures.size()));
    // Motion that an import writes is motion that the daemon accepts.
    if (scene && !scene->motion.empty()) {
        const auto outermost =
            static_cast<std::uint32_t>(scene->objects[scene->root].instances.size());
        const auto cameras = static_cast<std::uint32_t>(scene->cameras.size());
        const auto lights = static_cast<std::uint32_t>(scene->lights.size());
        fuzz::require(read_motion(scene->motion, outermost, cameras, lights).has_value());
    }
    return 0;
}
