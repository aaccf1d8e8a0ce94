// Foreign files that must load: those of Khronos' validator without an error, and odd ones.
#include "engine/assets/import.h"
#include "tests/unit/engine/assets/samples.h"

using namespace raynest;
namespace fs = std::filesystem;

namespace {

Result<std::shared_ptr<const Snapshot>> import(const fs::path& path) {
    static const auto registry = Registry::load({});
    REQUIRE(registry.has_value());
    const test::Upload upload(path);
    return import_here(upload.request(), ImportLimits{}, **registry);
}

std::shared_ptr<const Snapshot> must_import(const fs::path& path) {
    CAPTURE(path.string());
    auto scene = import(path);
    REQUIRE_MESSAGE(scene.has_value(), (scene ? "" : scene.error().message));
    return *scene;
}

/// Paths below hostile/gltf-validator/test for which validator 2.0.0-dev.3.10 reports no error.
constexpr const char* without_errors[] = {
    "base/data/accessor/custom_property.gltf",
    "base/data/accessor/unknown_type.gltf",
    "base/data/accessor/valid.gltf",
    "base/data/accessor_data/get_elements.gltf",
    "base/data/accessor_data/get_elements_matrix.gltf",
    "base/data/accessor_data/get_elements_sparse.gltf",
    "base/data/animation/custom_property.gltf",
    "base/data/animation/valid.gltf",
    "base/data/asset/2_1_version.gltf",
    "base/data/asset/custom_property.gltf",
    "base/data/asset/min_version_valid.gltf",
    "base/data/asset/valid.gltf",
    "base/data/buffer/custom_property.gltf",
    "base/data/buffer/data_uri.glb",
    "base/data/buffer/extra_padding.glb",
    "base/data/buffer/valid.glb",
    "base/data/buffer/valid.gltf",
    "base/data/buffer/valid_placeholder.glb",
    "base/data/buffer_view/custom_property.gltf",
    "base/data/buffer_view/valid.gltf",
    "base/data/camera/custom_property.gltf",
    "base/data/camera/perspective_yfov.gltf",
    "base/data/camera/valid.gltf",
    "base/data/glb/extra_data.glb",
    "base/data/glb/two_images.glb",
    "base/data/glb/valid.glb",
    "base/data/glb/valid_buffer.glb",
    "base/data/image/data_uri.glb",
    "base/data/image/valid.glb",
    "base/data/json/integer_written_as_float.gltf",
    "base/data/material/alpha_modes.gltf",
    "base/data/material/custom_property.gltf",
    "base/data/material/empty_object.gltf",
    "base/data/material/multiple_extensions.gltf",
    "base/data/material/valid.gltf",
    "base/data/mesh/custom_property.gltf",
    "base/data/mesh/invalid_tangent.gltf",
    "base/data/mesh/primitive_generated_tangent_space.gltf",
    "base/data/mesh/primitive_incompatible_mode.gltf",
    "base/data/mesh/primitive_no_position.gltf",
    "base/data/mesh/valid.gltf",
    "base/data/mesh_data/index_buffer_degenerate_triangle.gltf",
    "base/data/node/custom_property.gltf",
    "base/data/node/matrix_default.gltf",
    "base/data/node/node_empty.gltf",
    "base/data/node/node_skinned_mesh_without_skin.gltf",
    "base/data/node/node_weights_override.gltf",
    "base/data/node/valid.gltf",
    "base/data/root/custom_property.gltf",
    "base/data/root/custom_property_escaped_name.gltf",
    "base/data/root/extras_non_object.gltf",
    "base/data/root/invalid_extension_name.gltf",
    "base/data/root/valid.gltf",
    "base/data/sampler/custom_property.gltf",
    "base/data/sampler/empty_object.gltf",
    "base/data/sampler/valid.gltf",
    "base/data/scene/custom_property.gltf",
    "base/data/scene/valid.gltf",
    "base/data/skin/custom_property.gltf",
    "base/data/skin/ignored_animated_transform.gltf",
    "base/data/skin/ignored_local_transform.gltf",
    "base/data/skin/ignored_parent_transform.gltf",
    "base/data/skin/valid.gltf",
    "base/data/texture/custom_property.gltf",
    "base/data/texture/empty_object.gltf",
    "base/data/texture/valid.gltf",
    "ext/EXT_texture_webp/data/texture/custom_property.gltf",
    "ext/EXT_texture_webp/data/texture/empty_object.gltf",
    "ext/EXT_texture_webp/data/texture/valid.gltf",
    "ext/KHR_animation_pointer/data/animation/channel/target/custom_property.gltf",
    "ext/KHR_animation_pointer/data/animation/channel/target/missing_extension_declaration.gltf",
    "ext/KHR_animation_pointer/data/animation/channel/target/valid.gltf",
    "ext/KHR_lights_punctual/data/light/custom_property.gltf",
    "ext/KHR_lights_punctual/data/light/directional_light_with_range.gltf",
    "ext/KHR_lights_punctual/data/light/spot_object_with_non_spot_light.gltf",
    "ext/KHR_lights_punctual/data/light/unknown_type.gltf",
    "ext/KHR_lights_punctual/data/light/valid.gltf",
    "ext/KHR_lights_punctual/data/node/custom_property.gltf",
    "ext/KHR_lights_punctual/data/node/valid.gltf",
    "ext/KHR_materials_anisotropy/data/material/custom_property.gltf",
    "ext/KHR_materials_anisotropy/data/material/different_texcoords.gltf",
    "ext/KHR_materials_anisotropy/data/material/valid.gltf",
    "ext/KHR_materials_clearcoat/data/material/custom_property.gltf",
    "ext/KHR_materials_clearcoat/data/material/different_texcoords.gltf",
    "ext/KHR_materials_clearcoat/data/material/valid.gltf",
    "ext/KHR_materials_clearcoat/data/material/valid_with_tangent.gltf",
    "ext/KHR_materials_dispersion/data/material/custom_property.gltf",
    "ext/KHR_materials_dispersion/data/material/no_volume.gltf",
    "ext/KHR_materials_dispersion/data/material/valid.gltf",
    "ext/KHR_materials_emissive_strength/data/material/custom_property.gltf",
    "ext/KHR_materials_emissive_strength/data/material/valid.gltf",
    "ext/KHR_materials_emissive_strength/data/material/zero_factor.gltf",
    "ext/KHR_materials_ior/data/material/custom_property.gltf",
    "ext/KHR_materials_ior/data/material/valid.gltf",
    "ext/KHR_materials_iridescence/data/material/custom_property.gltf",
    "ext/KHR_materials_iridescence/data/material/unused_thickness_minimum.gltf",
    "ext/KHR_materials_iridescence/data/material/unused_thickness_texture.gltf",
    "ext/KHR_materials_iridescence/data/material/valid.gltf",
    "ext/KHR_materials_pbrSpecularGlossiness/data/material/custom_property.gltf",
    "ext/KHR_materials_pbrSpecularGlossiness/data/material/valid.gltf",
    "ext/KHR_materials_sheen/data/material/custom_property.gltf",
    "ext/KHR_materials_sheen/data/material/valid.gltf",
    "ext/KHR_materials_specular/data/material/custom_property.gltf",
    "ext/KHR_materials_specular/data/material/valid.gltf",
    "ext/KHR_materials_transmission/data/material/custom_property.gltf",
    "ext/KHR_materials_transmission/data/material/valid.gltf",
    "ext/KHR_materials_unlit/data/material/custom_property.gltf",
    "ext/KHR_materials_unlit/data/material/valid.gltf",
    "ext/KHR_materials_variants/data/primitive/custom_property.gltf",
    "ext/KHR_materials_variants/data/primitive/valid.gltf",
    "ext/KHR_materials_variants/data/variant/custom_property.gltf",
    "ext/KHR_materials_variants/data/variant/valid.gltf",
    "ext/KHR_materials_volume/data/material/custom_property.gltf",
    "ext/KHR_materials_volume/data/material/double_sided.gltf",
    "ext/KHR_materials_volume/data/material/unknown_transmission.gltf",
    "ext/KHR_materials_volume/data/material/valid.gltf",
    "ext/KHR_mesh_quantization/data/primitive/valid.gltf",
    "ext/KHR_node_visibility/data/node/custom_property.gltf",
    "ext/KHR_node_visibility/data/node/unexpected_extension.gltf",
    "ext/KHR_node_visibility/data/node/valid.gltf",
    "ext/KHR_texture_transform/data/textureInfo/custom_property.gltf",
    "ext/KHR_texture_transform/data/textureInfo/valid.gltf",
};
/// Files without an error whose visible mesh has its vertices in a buffer without data.
constexpr const char* without_data[] = {"base/data/root/named_objects.gltf",
                                        "base/data/root/unused_objects.gltf"};

}  // namespace

TEST_SUITE_BEGIN("shared scenes");

TEST_CASE("files without an error in Khronos' validator load") {
    if (!test::have_shared_scenes()) return;
    const fs::path folder = test::shared_scene("hostile/gltf-validator/test");
    for (const char* name : without_errors) {
        CAPTURE(name);
        const auto scene = import(folder / name);
        CHECK_MESSAGE(scene.has_value(), (scene ? "" : scene.error().message));
    }
}

TEST_CASE("a mesh without data cannot be shown") {
    if (!test::have_shared_scenes()) return;
    for (const char* name : without_data) {
        CAPTURE(name);
        const auto scene = import(test::shared_scene("hostile/gltf-validator/test") / name);
        REQUIRE_FALSE(scene.has_value());
        CHECK(scene.error().message.find("needs buffer 0, which has no data") != std::string::npos);
    }
}

TEST_CASE("odd files are shown as their README states") {
    if (!test::have_shared_scenes()) return;
    const auto odd = [](const char* name) { return must_import(test::shared_scene("odd") / name); };
    for (const char* name : {"uri_dot_slash.gltf", "buffer_longer_than_bytelength.gltf"}) {
        const auto scene = odd(name);
        CHECK(scene->statistics().instances == 1);
        CHECK(scene->statistics().warnings.empty());
    }
    const auto unused = odd("unused_missing_image.gltf");
    CHECK(unused->statistics().instances == 1);
    CHECK(unused->statistics().warnings.size() == 1);
    const auto kit = odd("scene_lists_inner_node.glb");
    CHECK(kit->statistics().instances == 6);
    REQUIRE(kit->statistics().warnings.size() == 1);
    CHECK(kit->statistics().warnings[0].find("by its own transform") != std::string::npos);
    const auto glossy = odd("specular_glossiness_alpha.glb");
    CHECK(glossy->statistics().mask_materials == 1);
    CHECK(glossy->view().materials[0].base_colour.a < 1);
}

TEST_SUITE_END();
