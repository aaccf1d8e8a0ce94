#include "engine/assets/gltf/write/tables.h"
#include "engine/assets/images/image.h"
#include "engine/shading/types.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

namespace raynest::gltf {
namespace {

using Json = nlohmann::json;

constexpr int wrap_words[] = {10497, 33071, 33648};  // Wrap, as WebGL numbers it
constexpr int nearest = 9728, linear = 9729;

Json three(const Vec3& v) {
    return Json::array({v.x, v.y, v.z});
}

/// The power of two that brings a colour to at most 1: exact both ways.
float scale_of(const Vec3& colour) {
    const float most = std::max({colour.x, colour.y, colour.z});
    return most > 1 ? std::exp2(std::ceil(std::log2(most))) : 1.0F;
}

class MaterialWriter {
public:
    MaterialWriter(const Snapshot& scene, Tables& tables)
        : view_(scene.view()),
          surfaces_(scene.shading().surfaces),
          tables_(tables) {}

    Result<void> write() {
        for (std::uint32_t i = 0; i < view_.texture_count; ++i)
            if (auto done = add_texture(view_.textures[i]); !done) return done;
        for (std::uint32_t i = 0; i < view_.material_count; ++i)
            tables_.materials.add(material(view_.materials[i], surfaces_[i])
                                      .dump(-1, ' ', false, Json::error_handler_t::replace));
        if (cut_ != 0)
            tables_.warnings.push_back(fmt::format(
                "{} materials have a base colour beyond 1, where glTF ends: they are darker there",
                cut_));
        return {};
    }

private:
    /// Textures of one picture share its planes.
    Result<void> add_texture(const TextureRecord& texture) {
        const auto [known, is_new] = images_.try_emplace(texture.colour, tables_.images.count);
        if (is_new) {
            const std::size_t bytes = std::size_t{4} * texture.width * texture.height;
            auto png = encode_png(texture.width, texture.height,
                                  {view_.attribute<std::uint8_t>(texture.colour), bytes});
            if (!png) return tl::unexpected(png.error());
            const std::uint32_t view = tables_.keep_bytes(std::move(*png));
            tables_.images.add(Json{{"bufferView", view}, {"mimeType", "image/png"}}.dump());
        }
        const std::uint32_t sampler = tables_.samplers.add(Json{
            {"magFilter", texture.nearest != 0 ? nearest : linear},
            {"wrapS", wrap_words[static_cast<int>(texture.wrap_s)]},
            {"wrapT",
             wrap_words[static_cast<int>(texture.wrap_t)]}}.dump());
        tables_.textures.add(Json{{"source", known->second}, {"sampler", sampler}}.dump());
        return {};
    }

    Json use(std::uint32_t texture, std::uint32_t texcoord, const float (&rows)[6]) {
        Json info{{"index", texture}};
        if (texcoord != 0) info["texCoord"] = texcoord;
        const double a{rows[0]}, b{rows[1]}, c{rows[2]}, d{rows[3]}, e{rows[4]}, f{rows[5]};
        if (a == 1 && b == 0 && c == 0 && d == 0 && e == 1 && f == 0) return info;
        Json map{{"offset", {c, f}}};
        if (b == 0 && d == 0) {
            map["scale"] = {a, e};
        } else {
            const double rotation = a == 0 && d == 0 ? std::atan2(b, e) : std::atan2(-d, a);
            const double sine = std::sin(rotation), cosine = std::cos(rotation);
            map["rotation"] = rotation;
            map["scale"] = {std::hypot(a, d),
                            std::abs(cosine) > std::abs(sine) ? e / cosine : b / sine};
        }
        tables_.extensions.insert("KHR_texture_transform");
        info["extensions"]["KHR_texture_transform"] = std::move(map);
        return info;
    }

    Json material(const MaterialRecord& in, const SurfaceRecord& surface) {
        const Vec4 colour = glm::clamp(in.base_colour, 0.0F, 1.0F);
        if (colour != in.base_colour) ++cut_;
        Json pbr{{"baseColorFactor", {colour.x, colour.y, colour.z, colour.w}},
                 {"metallicFactor", surface.metallic},
                 {"roughnessFactor", surface.roughness}};
        if (in.texture != no_id)
            pbr["baseColorTexture"] = use(in.texture, in.texcoord, in.uv_transform);
        add(pbr, "metallicRoughnessTexture", surface, TextureSlot::metallic_roughness);
        Json out{{"pbrMetallicRoughness", std::move(pbr)}};
        if (const char* name = view_.names + in.name; *name != '\0') out["name"] = name;
        if (in.alpha_mode != AlphaMode::opaque)
            out["alphaMode"] = in.alpha_mode == AlphaMode::mask ? "MASK" : "BLEND";
        if (in.alpha_mode == AlphaMode::mask) out["alphaCutoff"] = in.cutoff;
        if (in.double_sided != 0) out["doubleSided"] = true;
        if (add(out, "normalTexture", surface, TextureSlot::normal))
            out["normalTexture"]["scale"] = surface.normal_scale;
        if (add(out, "occlusionTexture", surface, TextureSlot::occlusion))
            out["occlusionTexture"]["strength"] = surface.occlusion_strength;
        add(out, "emissiveTexture", surface, TextureSlot::emission);
        const float strength = scale_of(surface.emission);
        if (surface.emission != Vec3(0)) out["emissiveFactor"] = three(surface.emission / strength);
        if (strength != 1)
            extend(out, "KHR_materials_emissive_strength", {{"emissiveStrength", strength}});
        if (surface.ior != 1.5F) extend(out, "KHR_materials_ior", {{"ior", surface.ior}});
        if (surface.transmission != 0) {
            Json glass{{"transmissionFactor", surface.transmission}};
            add(glass, "transmissionTexture", surface, TextureSlot::transmission);
            extend(out, "KHR_materials_transmission", std::move(glass));
        }
        if (surface.thickness != 0 || surface.attenuation_distance != 0) {
            Json solid{{"thicknessFactor", surface.thickness},
                       {"attenuationColor", three(surface.attenuation_colour)}};
            if (surface.attenuation_distance != 0)
                solid["attenuationDistance"] = surface.attenuation_distance;
            extend(out, "KHR_materials_volume", std::move(solid));
        }
        add_layers(out, surface);
        if (surface.kind == shading_type("unlit"))
            extend(out, "KHR_materials_unlit", Json::object());
        else if (const char* kind = material_name(surface.kind);
                 kind != nullptr && surface.kind != default_material() &&
                 surface.kind != shading_type("layered"))
            out["extras"]["raynest"]["material"] = kind;
        return out;
    }

    /// Adds the texture of a slot, if there is one.
    bool add(Json& to, const char* name, const SurfaceRecord& surface, TextureSlot slot) {
        const TextureUse& of = surface.use(slot);
        if (of.texture == no_id) return false;
        to[name] = use(of.texture, of.texcoord, of.uv_transform);
        return true;
    }

    /// Writes a factor of an extension, or of one of its textures: `word` names that before a dot.
    static void put(Json& to, const std::string& word, Json value) {
        const std::size_t dot = word.find('.');
        if (dot == std::string::npos)
            to[word] = std::move(value);
        else if (const auto texture = to.find(word.substr(0, dot)); texture != to.end())
            (*texture)[word.substr(dot + 1)] = std::move(value);
    }
    static Json json_of(float x) { return x; }
    static Json json_of(const Vec3& v) { return three(v); }

    /// Writes the extensions of a `layered` material, those alone that add something.
    void add_layers(Json& out, const SurfaceRecord& surface) {
        std::map<std::string, Json> layers;
#define RAYNEST_MATERIAL_LAYER(extension, condition) \
    if (raynest::adds(Layer::extension, surface)) layers[#extension];
#include "engine/shading/material_layers.def"
        for (auto& [extension, layer] : layers) {
#define RAYNEST_MATERIAL_LAYER_MAP(of, word, slot) \
    if (extension == #of) add(layer, word, surface, TextureSlot::slot);
#include "engine/shading/material_layers.def"
#define RAYNEST_MATERIAL_LAYER_FACTOR(of, word, Type, name, otherwise, least, most) \
    if (extension == #of) put(layer, word, json_of(surface.layers.name));
#include "engine/shading/material_layers.def"
            extend(out, extension.c_str(), std::move(layer));
        }
    }

    void extend(Json& material, const char* name, Json extension) {
        tables_.extensions.insert(name);
        material["extensions"][name] = std::move(extension);
    }

    const SceneView& view_;
    const SurfaceRecord* surfaces_;
    Tables& tables_;
    std::uint64_t cut_ = 0;
    std::map<std::uint64_t, std::uint32_t> images_;  ///< by offset of the plane
};

}  // namespace

Result<void> write_materials(const Snapshot& scene, Tables& tables) {
    return MaterialWriter(scene, tables).write();
}

}  // namespace raynest::gltf
