// Materials' scattering and lights of a glTF: what is read, and what becomes of values that make no
// sense.
#include "engine/scene/snapshot.h"
#include "engine/shading/types.h"
#include "tests/unit/engine/assets/describe.h"

#include <cmath>
#include <numbers>
#include <string_view>

using namespace raynest;
using test::contains;
using test::describe;
using test::must_describe;

namespace {

/// A .gltf of one triangle with normals, and these materials, lights and node members.
test::Bytes file_of(const std::string& material, const std::string& lights = "",
                    const std::string& node = "", const std::string& attributes = "") {
    const std::string base64 = "AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA";
    return test::to_bytes(
        R"({"asset":{"version":"2.0"},"extensionsUsed":["KHR_lights_punctual"],)" +
        (lights.empty() ? std::string()
                        : R"("extensions":{"KHR_lights_punctual":{"lights":[)" + lights + "]}},") +
        R"("buffers":[{"byteLength":36,"uri":"data:application/octet-stream;base64,)" + base64 +
        R"("}],"bufferViews":[{"buffer":0,"byteLength":36}],"accessors":[{"bufferView":0,
        "componentType":5126,"count":3,"type":"VEC3"},{"bufferView":0,"componentType":5126,
        "count":2,"type":"VEC3"}],"materials":[)" +
        material + R"(],"meshes":[{"primitives":[{"material":0,"attributes":{"POSITION":0)" +
        attributes + R"(}}]}],"nodes":[{"mesh":0})" + (node.empty() ? "" : "," + node) + "]}");
}

SceneDescription lit(const std::string& material, const std::string& lights = "",
                     const std::string& node = "") {
    return must_describe(file_of(material, lights, node), "scene.gltf");
}

/// A scene that is described can be built, too.
void check_builds(const SceneDescription& scene) {
    const auto snapshot = Snapshot::build(scene);
    REQUIRE_MESSAGE(snapshot.has_value(), (snapshot ? "" : snapshot.error().message));
}

bool warns_of(const SceneDescription& scene, const std::string& text) {
    for (const std::string& warning : scene.warnings)
        if (contains(warning, text)) return true;
    return false;
}

}  // namespace

TEST_CASE("an occlusion texture is named, because nothing reads it") {
    const std::string texture = R"("occlusionTexture":{"index":0})";
    const SceneDescription scene =
        must_describe(test::to_bytes(std::string(R"({"asset":{"version":"2.0"},"textures":[{}],
            "materials":[{"name":"a",)") +
                                     texture + R"(},{)" + texture + R"(}],
            "meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],"nodes":[{"mesh":0}],
            "buffers":[{"byteLength":36,"uri":"data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA"}],
            "bufferViews":[{"buffer":0,"byteLength":36}],"accessors":[{"bufferView":0,
            "componentType":5126,"count":3,"type":"VEC3"}]})"),
                      "scene.gltf");
    CHECK(warns_of(scene, "1 other: its occlusion texture is not used"));
}

TEST_CASE("a material's factors and extensions are read") {
    const SceneDescription scene = lit(R"({"pbrMetallicRoughness":{"metallicFactor":0.25,
        "roughnessFactor":0.5},"emissiveFactor":[1,0.5,0],"extensions":{
        "KHR_materials_emissive_strength":{"emissiveStrength":4},
        "KHR_materials_ior":{"ior":1.8},
        "KHR_materials_transmission":{"transmissionFactor":0.75},
        "KHR_materials_volume":{"thicknessFactor":2,"attenuationDistance":3,
                                "attenuationColor":[1,0.5,0.25]}}})");
    const SurfaceRecord& s = scene.materials[0].surface;
    CHECK(s.metallic == 0.25F);
    CHECK(s.roughness == 0.5F);
    CHECK(s.emission == Vec3(4, 2, 0));
    CHECK(s.ior == 1.8F);
    CHECK(s.transmission == 0.75F);
    CHECK(s.thickness == 2);
    CHECK(s.attenuation_distance == 3);
    CHECK(s.attenuation_colour == Vec3(1, 0.5F, 0.25F));
    CHECK(scene.warnings.empty());
    check_builds(scene);
    // glTF's defaults: metal, and rough.
    const SurfaceRecord plain = lit("{}").materials[0].surface;
    CHECK(plain.metallic == 1);
    CHECK(plain.roughness == 1);
    CHECK(plain.emission == Vec3(0));
    CHECK(lit(R"({"extensions":{"KHR_materials_unlit":{}}})").materials[0].surface.kind ==
          *material_kind("unlit"));
}

TEST_CASE("the layers of a material are read, and make it `layered` where they add something") {
    const SceneDescription scene = lit(R"({"extensions":{
        "KHR_materials_clearcoat":{"clearcoatFactor":0.5,"clearcoatRoughnessFactor":0.25},
        "KHR_materials_sheen":{"sheenColorFactor":[1,0.5,0.25],"sheenRoughnessFactor":0.75},
        "KHR_materials_specular":{"specularFactor":0.125,"specularColorFactor":[2,1,0]},
        "KHR_materials_iridescence":{"iridescenceFactor":0.375,"iridescenceIor":1.5,
            "iridescenceThicknessMinimum":200,"iridescenceThicknessMaximum":500},
        "KHR_materials_anisotropy":{"anisotropyStrength":0.625,"anisotropyRotation":1.5}}})");
    const SurfaceRecord& s = scene.materials[0].surface;
    CHECK(s.kind == *material_kind("layered"));
    CHECK(s.layers.clearcoat == 0.5F);
    CHECK(s.layers.clearcoat_roughness == 0.25F);
    CHECK(s.layers.sheen == Vec3(1, 0.5F, 0.25F));
    CHECK(s.layers.sheen_roughness == 0.75F);
    CHECK(s.layers.specular == 0.125F);
    CHECK(s.layers.specular_colour == Vec3(2, 1, 0));
    CHECK(s.layers.iridescence == 0.375F);
    CHECK(s.layers.iridescence_ior == 1.5F);
    CHECK(s.layers.thickness_least == 200);
    CHECK(s.layers.thickness_most == 500);
    CHECK(s.layers.anisotropy == 0.625F);
    CHECK(s.layers.anisotropy_turn == 1.5F);
    CHECK(scene.warnings.empty());
    check_builds(scene);
    for (const char* none :
         {R"({"extensions":{"KHR_materials_clearcoat":{}}})",
          R"({"extensions":{"KHR_materials_sheen":{"sheenRoughnessFactor":1}}})",
          R"({"extensions":{"KHR_materials_specular":{"specularFactor":1}}})",
          R"({"extensions":{"KHR_materials_iridescence":{"iridescenceIor":2}}})",
          R"({"extensions":{"KHR_materials_anisotropy":{"anisotropyRotation":1}}})"}) {
        CAPTURE(none);
        const SceneDescription plain = lit(none);
        CHECK(plain.materials[0].surface.kind != *material_kind("layered"));
        CHECK(plain.warnings.empty());
    }
}

TEST_CASE("a texture alone of KHR_materials_specular makes a material `layered`: factors are 1") {
    const std::string material =
        R"({"extensions":{"KHR_materials_specular":{"specularTexture":{"index":0}}}})";
    const test::Bytes file = file_of(material);
    std::string text(reinterpret_cast<const char*>(file.data()), file.size());
    const std::string_view before = R"("materials":)";
    text.replace(text.find(before), before.size(), R"("images":[{"uri":
        "data:image/png;base64,iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg=="}],
        "textures":[{"source":0}],"materials":)");
    const SceneDescription scene = must_describe(test::to_bytes(text), "scene.gltf");
    CHECK(scene.materials[0].surface.has(TextureSlot::specular));
    CHECK(scene.materials[0].surface.kind == *material_kind("layered"));
}

TEST_CASE("values out of range are replaced, each with a line") {
    const struct {
        const char* material;
        const char* warning;
    } cases[] = {
        {R"({"pbrMetallicRoughness":{"metallicFactor":7}})", "metallicFactor"},
        {R"({"pbrMetallicRoughness":{"roughnessFactor":-1}})", "roughnessFactor"},
        {R"({"pbrMetallicRoughness":{"roughnessFactor":1e300}})", "roughnessFactor"},
        {R"({"pbrMetallicRoughness":{"baseColorFactor":[5,1,1,1]}})", "base colour"},
        {R"({"pbrMetallicRoughness":{"baseColorFactor":[1,1,-1,1]}})", "base colour"},
        {R"({"emissiveFactor":[1,-1,0]})", "emission"},
        {R"({"emissiveFactor":[1,1,1],"extensions":{"KHR_materials_emissive_strength":{"emissiveStrength":1e39}}})",
         "emission"},
        {R"({"extensions":{"KHR_materials_emissive_strength":{"emissiveStrength":"much"}}})",
         "emissiveStrength"},
        {R"({"extensions":{"KHR_materials_ior":{"ior":-2}}})", "ior"},
        {R"({"extensions":{"KHR_materials_transmission":{"transmissionFactor":3}}})",
         "transmissionFactor"},
        {R"({"extensions":{"KHR_materials_volume":{"thicknessFactor":-1}}})", "thicknessFactor"},
        {R"({"extensions":{"KHR_materials_volume":{"attenuationColor":[1,2]}}})",
         "attenuationColor"},
        {R"({"extensions":{"KHR_materials_clearcoat":{"clearcoatFactor":2}}})", "clearcoatFactor"},
        {R"({"extensions":{"KHR_materials_clearcoat":{"clearcoatNormalTexture":{"scale":"big"}}}})",
         "scale"},
        {R"({"extensions":{"KHR_materials_sheen":{"sheenColorFactor":[1,2,1]}}})",
         "sheenColorFactor"},
        {R"({"extensions":{"KHR_materials_sheen":{"sheenColorFactor":"red"}}})",
         "sheenColorFactor"},
        {R"({"extensions":{"KHR_materials_specular":{"specularColorFactor":[1e9,1,1]}}})",
         "specularColorFactor"},
        {R"({"extensions":{"KHR_materials_iridescence":{"iridescenceIor":0.5}}})",
         "iridescenceIor"},
        {R"({"extensions":{"KHR_materials_iridescence":{"iridescenceThicknessMaximum":-1}}})",
         "iridescenceThicknessMaximum"},
        {R"({"extensions":{"KHR_materials_anisotropy":{"anisotropyRotation":1e300}}})",
         "anisotropyRotation"},
        {R"({"extensions":{"KHR_materials_dispersion":{}}})",
         "KHR_materials_dispersion is not supported"},
        {R"({"extras":{"raynest":{"material":"velvet"}}})",
         "this build has standard, layered, unlit"},
    };
    for (const auto& [material, warning] : cases) {
        CAPTURE(material);
        const SceneDescription scene = lit(material);
        CHECK(scene.warnings.size() == 1);
        CHECK(warns_of(scene, warning));
        check_builds(scene);
    }
    const auto layers = [](const char* material) {
        return lit(material).materials[0].surface.layers;
    };
    CHECK(
        layers(R"({"extensions":{"KHR_materials_sheen":{"sheenColorFactor":[0.5,2,-1]}}})").sheen ==
        Vec3(0.5F, 1, 0));
    CHECK(lit(R"({"extras":{"raynest":{"material":"unlit"}}})").materials[0].surface.kind ==
          *material_kind("unlit"));
}

TEST_CASE("textures of materials are indices like any other") {
    for (const char* beyond :
         {R"({"normalTexture":{"index":3}})",
          R"({"extensions":{"KHR_materials_clearcoat":{"clearcoatNormalTexture":{"index":3}}}})",
          R"({"extensions":{"KHR_materials_anisotropy":{"anisotropyTexture":{"index":3}}}})"}) {
        CAPTURE(beyond);
        const auto scene = describe(file_of(beyond), "scene.gltf");
        REQUIRE_FALSE(scene);
        CHECK(contains(scene.error().message, "texture"));
    }
}

TEST_CASE("normals are read, and bad ones are left out with a line") {
    const SceneDescription good =
        must_describe(file_of("{}", "", "", R"(,"NORMAL":0)"), "scene.gltf");
    CHECK(good.objects[0].geometries[0].normals.size() == 3);
    // They are the positions, of which one is 0.
    CHECK(good.warnings.size() == 1);
    CHECK(warns_of(good, "are 0 or not finite"));
    check_builds(good);
    for (const char* bad : {R"(,"NORMAL":1)", R"(,"NORMAL":7)", R"(,"NORMAL":-3)"}) {
        CAPTURE(bad);
        const SceneDescription scene = must_describe(file_of("{}", "", "", bad), "scene.gltf");
        CHECK(scene.objects[0].geometries[0].normals.empty());
        CHECK(scene.warnings.size() == 1);
        CHECK(warns_of(scene, "NORMAL"));
        check_builds(scene);
    }
}

TEST_CASE("lights stand where their nodes are") {
    const SceneDescription scene = lit(
        "{}",
        R"({"type":"point","color":[1,0.5,0],"intensity":20,"range":8,"name":"lamp"},
           {"type":"spot","spot":{"innerConeAngle":0.1,"outerConeAngle":0.5}},
           {"type":"directional"})",
        R"({"name":"a","translation":[1,2,3],"scale":[9,9,9],"extensions":{"KHR_lights_punctual":{"light":0}}},
           {"rotation":[-0.7071068,0,0,0.7071068],"extensions":{"KHR_lights_punctual":{"light":1}}},
           {"extensions":{"KHR_lights_punctual":{"light":2}}})");
    REQUIRE(scene.lights.size() == 3);
    CHECK(scene.warnings.empty());
    const LightRecord& point = scene.lights[0].light;
    CHECK(scene.lights[0].name == "a");
    CHECK(point.kind == *light_kind("point"));
    CHECK(point.position == Vec3(1, 2, 3));
    CHECK(point.intensity == Vec3(20, 10, 0));
    CHECK(point.range == 8);
    const LightRecord& spot = scene.lights[1].light;
    CHECK(spot.direction.y == doctest::Approx(-1));
    CHECK(spot.own[0] == doctest::Approx(std::cos(0.1)));
    CHECK(spot.own[1] == doctest::Approx(std::cos(0.5)));
    CHECK(scene.lights[2].light.direction == Vec3(0, 0, -1));
    CHECK(scene.lights[2].light.intensity == Vec3(1));
    check_builds(scene);
    const auto snapshot = Snapshot::build(scene);
    CHECK((*snapshot)->shading().light_count == 3);
}

TEST_CASE("lights that make no sense are left out or mended, each with a line") {
    const std::string node = R"({"name":"n","extensions":{"KHR_lights_punctual":{"light":0}}})";
    const struct {
        const char* light;
        std::size_t lights;
        const char* warning;
    } cases[] = {
        {R"({"type":"point","intensity":-3})", 0, "negative"},
        {R"({"type":"point","intensity":1e300})", 0, "not finite"},
        {R"({"type":"point","intensity":3e38})", 0, "beyond 1e+30"},
        {R"({"type":"point","color":[1,-1,1]})", 0, "negative"},
        {R"({"type":"laser"})", 0, "laser"},
        {R"({"type":"point","range":-1})", 1, "range"},
        {R"({"type":"spot","spot":{"innerConeAngle":2,"outerConeAngle":1}})", 1, "cone"},
        {R"({"type":"spot","spot":{"outerConeAngle":1e300}})", 1, "cone"},
        {R"({"type":"spot"})", 1, "has no member spot; cone angles of 0 and 45 degrees"},
        {R"({"type":"spot","spot":7})", 1, "has no member spot"},
        {R"({"intensity":2})", 0, "unknown type ''"},
        {R"({"type":"point","extras":{"raynest":{"light":"laser"}}})", 1, "this build has point"},
    };
    for (const auto& [light, lights, warning] : cases) {
        CAPTURE(light);
        const SceneDescription scene = lit("{}", light, node);
        CHECK(scene.lights.size() == lights);
        CHECK(scene.warnings.size() == 1);
        CHECK(warns_of(scene, warning));
        if (std::string_view(light).find("spot") != std::string_view::npos) {
            const auto& cosines = scene.lights.at(0).light.own;
            CHECK(cosines[0] == 1);
            CHECK(cosines[1] == doctest::Approx(std::cos(std::numbers::pi / 4)));
        }
        check_builds(scene);
    }
    // A node without a size has no direction for its light; a light that is not there is none.
    CHECK(warns_of(lit("{}", R"({"type":"point"})",
                       R"({"scale":[0,0,0],"extensions":{"KHR_lights_punctual":{"light":0}}})"),
                   "its light is left out, because it has no direction"));
    CHECK(warns_of(
        lit("{}", R"({"type":"point"})", R"({"extensions":{"KHR_lights_punctual":{"light":5}}})"),
        "a light that does not exist"));
    CHECK(warns_of(
        lit("{}", R"({"type":"point"})", R"({"extensions":{"KHR_lights_punctual":{"light":"x"}}})"),
        "a light that does not exist"));
}
