// glTF's metallic-roughness material and its extensions -> SurfaceRecord.
#include "engine/assets/gltf/file/values.h"
#include "engine/shading/types.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

namespace raynest::gltf {
namespace {

/// Extensions of materials that are read, here or with the base colour.
constexpr std::array supported = {
    "KHR_materials_unlit",  "KHR_materials_emissive_strength",
    "KHR_materials_ior",    "KHR_materials_transmission",
    "KHR_materials_volume", "KHR_materials_pbrSpecularGlossiness",
#define RAYNEST_MATERIAL_LAYER(extension, condition) #extension,
#include "engine/shading/material_layers.def"
};

constexpr double ior_most = 10;
constexpr double emission_most = 1e12;

class SurfaceReader {
public:
    SurfaceReader(const tinygltf::Material& in, const std::string& where, Model& model)
        : in_(in),
          where_(where),
          model_(model) {}

    Result<void> read(SurfaceRecord& surface) {
        const tinygltf::PbrMetallicRoughness& pbr = in_.pbrMetallicRoughness;
        surface.metallic = in_range("metallicFactor", pbr.metallicFactor, 0, 1, 1);
        surface.roughness = in_range("roughnessFactor", pbr.roughnessFactor, 0, 1, 1);
        surface.normal_scale =
            in_range("normalTexture.scale", in_.normalTexture.scale, -1e3, 1e3, 1);
        surface.occlusion_strength =
            in_range("occlusionTexture.strength", in_.occlusionTexture.strength, 0, 1, 1);
        if (const auto* old = extension("KHR_materials_pbrSpecularGlossiness")) {
            surface.metallic = 0;
            surface.roughness =
                1 - in_range("glossinessFactor", number(*old, "glossinessFactor", 1), 0, 1, 1);
        } else if (auto done = use(pbr.metallicRoughnessTexture,
                                   surface.use(TextureSlot::metallic_roughness));
                   !done) {
            return done;
        }
        if (auto done = use(in_.normalTexture, surface.use(TextureSlot::normal)); !done)
            return done;
        if (auto done = use(in_.occlusionTexture, surface.use(TextureSlot::occlusion)); !done)
            return done;
        if (auto done = use(in_.emissiveTexture, surface.use(TextureSlot::emission)); !done)
            return done;
        read_emission(surface);
        if (const auto* ior = extension("KHR_materials_ior")) {
            const double value = number(*ior, "ior", 1.5);
            // 0 stands for a surface that reflects all light.
            surface.ior = value == 0 ? static_cast<float>(ior_most)
                                     : in_range("ior", value, 1, ior_most, 1.5);
        }
        if (auto done = read_transmission(surface); !done) return done;
        if (auto done = read_layers(surface); !done) return done;
        if (has_layers(surface)) surface.kind = shading_type("layered");
        name_unsupported();
        return read_kind(surface);
    }

private:
    [[nodiscard]] const tinygltf::Value* extension(const char* name) const {
        const auto found = in_.extensions.find(name);
        return found == in_.extensions.end() ? nullptr : &found->second;
    }

    double number(const tinygltf::Value& object, const char* name, double otherwise) {
        const tinygltf::Value* const value = member(object, name);
        if (value == nullptr) return otherwise;
        if (value->IsNumber()) return value->GetNumberAsDouble();
        model_.odd.add(where_, fmt::format("{} is no number; the default is used", name));
        return otherwise;
    }

    float in_range(const char* name, double value, double least, double most, double otherwise) {
        if (value >= least && value <= most) return static_cast<float>(value);
        const bool finite = std::isfinite(value);
        const double used = finite ? std::clamp(value, least, most) : otherwise;
        model_.odd.add(where_,
                       fmt::format("{} is {}; {:g} is used", name,
                                   finite ? fmt::format("not within {:g} and {:g}", least, most)
                                          : std::string("not finite"),
                                   used));
        return static_cast<float>(used);
    }

    Vec3 colour(const char* name, const std::array<double, 3>& value, double most,
                const Vec3& otherwise) {
        Vec3 used;
        for (int i = 0; i < 3; ++i)
            used[i] = in_range(name, value[static_cast<std::size_t>(i)], 0, most, otherwise[i]);
        return used;
    }

    /// Takes over a textureInfo.
    template <class Info>
    Result<void> use(const Info& info, TextureUse& use) {
        const auto found = info.extensions.find("KHR_texture_transform");
        return use_of(info.index, info.texCoord,
                      found == info.extensions.end() ? nullptr : &found->second, use);
    }
    Result<void> use_of(std::int64_t index, std::int64_t texcoord, const tinygltf::Value* transform,
                        TextureUse& use) {
        const auto texture = optional_index(index, model_.textures.size(), "texture");
        if (!texture) return error_of(texture);
        use.texture = *texture;
        if (texcoord < 0) model_.odd.add(where_, "texCoord is negative; 0 is used");
        use.texcoord = static_cast<std::uint32_t>(std::max<std::int64_t>(texcoord, 0));
        if (transform != nullptr && !read_uv_transform(*transform, use.uv_transform, use.texcoord))
            model_.odd.add(where_,
                           "KHR_texture_transform has missing or invalid numbers; it is ignored");
        return {};
    }

    /// The same for a textureInfo within an extension; nothing where there is none.
    Result<void> use_in(const tinygltf::Value& of, const char* name, TextureUse& use) {
        const tinygltf::Value* const info = member(of, name);
        if (info == nullptr) return {};
        const auto* extensions = member(*info, "extensions");
        return use_of(
            static_cast<std::int64_t>(number(*info, "index", -1)),
            static_cast<std::int64_t>(number(*info, "texCoord", 0)),
            extensions == nullptr ? nullptr : member(*extensions, "KHR_texture_transform"), use);
    }

    Vec3 colour_in(const tinygltf::Value& of, const char* name, double most,
                   const std::array<double, 3>& otherwise) {
        std::array<double, 3> value = otherwise;
        if (!read_numbers(member(of, name), value)) {
            model_.odd.add(where_,
                           fmt::format("{} is not three numbers; the default is used", name));
            value = otherwise;
        }
        return colour(name, value, most,
                      Vec3(glm::dvec3(otherwise[0], otherwise[1], otherwise[2])));
    }

    /// A number of an extension, or of one of its textures: `word` names that before a dot.
    void take(const tinygltf::Value& of, const std::string& word, float least, float most,
              float& factor) {
        const std::size_t dot = word.find('.');
        const tinygltf::Value* const at =
            dot == std::string::npos ? &of : member(of, word.substr(0, dot).c_str());
        if (at == nullptr) return;
        const char* const name = word.c_str() + (dot == std::string::npos ? 0 : dot + 1);
        factor = in_range(word.c_str(), number(*at, name, factor), least, most, factor);
    }
    void take(const tinygltf::Value& of, const std::string& word, float /*least*/, float most,
              Vec3& factor) {
        factor = colour_in(of, word.c_str(), most, {factor.x, factor.y, factor.z});
    }

    Result<void> read_layers(SurfaceRecord& surface) {
#define RAYNEST_MATERIAL_LAYER_FACTOR(layer, word, Type, name, otherwise, least, most) \
    if (const auto* of = extension(#layer)) take(*of, word, least, most, surface.layers.name);
#define RAYNEST_MATERIAL_LAYER_MAP(layer, word, slot) \
    if (const auto* of = extension(#layer))           \
        if (auto done = use_in(*of, word, surface.use(TextureSlot::slot)); !done) return done;
#include "engine/shading/material_layers.def"
        return {};
    }

    void read_emission(SurfaceRecord& surface) {
        std::array<double, 3> factor{0, 0, 0};
        if (in_.emissiveFactor.size() == 3)
            std::copy_n(in_.emissiveFactor.begin(), 3, factor.begin());
        else if (!in_.emissiveFactor.empty())
            model_.odd.add(where_, "emissiveFactor is not three numbers; black is used");
        if (const auto* stronger = extension("KHR_materials_emissive_strength")) {
            const double strength = number(*stronger, "emissiveStrength", 1);
            for (double& x : factor) x *= strength;
        }
        surface.emission = colour("its emission", factor, emission_most, Vec3(0));
    }

    Result<void> read_transmission(SurfaceRecord& surface) {
        if (const auto* clear = extension("KHR_materials_transmission")) {
            surface.transmission =
                in_range("transmissionFactor", number(*clear, "transmissionFactor", 0), 0, 1, 0);
            if (auto done =
                    use_in(*clear, "transmissionTexture", surface.use(TextureSlot::transmission));
                !done)
                return done;
        }
        const auto* volume = extension("KHR_materials_volume");
        if (volume == nullptr) return {};
        constexpr double longest = std::numeric_limits<float>::max();
        surface.thickness =
            in_range("thicknessFactor", number(*volume, "thicknessFactor", 0), 0, longest, 0);
        const double distance = number(*volume, "attenuationDistance", 0);
        if (distance > 0 && distance <= longest)
            surface.attenuation_distance = static_cast<float>(distance);
        surface.attenuation_colour = colour_in(*volume, "attenuationColor", 1, {1, 1, 1});
        return {};
    }

    void name_unsupported() {
        if (in_.occlusionTexture.index >= 0)
            model_.odd.add(where_, "its occlusion texture is not used: rays find what hides light");
        for (const auto& [name, value] : in_.extensions) {
            if (name.starts_with("KHR_materials_") &&
                std::find(supported.begin(), supported.end(), name) == supported.end())
                model_.odd.add(where_,
                               one_line(name, 60) + " is not supported; the base material is used");
        }
    }

    Result<void> read_kind(SurfaceRecord& surface) {
        if (extension("KHR_materials_unlit") != nullptr) {
            surface.kind = shading_type("unlit");
            surface.emission = Vec3(0);
        }
        const std::string name = raynest_extra(in_.extras, "material");
        if (name.empty()) return {};
        if (const auto kind = material_kind(name))
            surface.kind = *kind;
        else
            model_.odd.add(where_,
                           fmt::format("extras.raynest.material names '{}'; this build has {}",
                                       one_line(name, 60), material_names()));
        return {};
    }

    const tinygltf::Material& in_;
    const std::string& where_;
    Model& model_;
};

}  // namespace

Result<void> convert_surface(const tinygltf::Material& in, const std::string& where, Model& model,
                             MaterialDescription& material) {
    return SurfaceReader(in, where, model).read(material.surface);
}

}  // namespace raynest::gltf
