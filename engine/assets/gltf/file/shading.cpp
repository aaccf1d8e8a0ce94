// Converts textures and materials that tinygltf read into those of a Model, checked.
#include "engine/assets/gltf/file/convert.h"
#include "engine/assets/gltf/file/values.h"
#include "engine/assets/input/messages.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <optional>

namespace raynest::gltf {
namespace {

/// Returns the wrap mode, or nothing if it is unknown.
std::optional<Wrap> convert_wrap(int value) {
    if (value == TINYGLTF_TEXTURE_WRAP_REPEAT) return Wrap::repeat;
    if (value == TINYGLTF_TEXTURE_WRAP_CLAMP_TO_EDGE) return Wrap::clamp;
    if (value == TINYGLTF_TEXTURE_WRAP_MIRRORED_REPEAT) return Wrap::mirror;
    return std::nullopt;
}

}  // namespace

Result<void> convert_textures(tinygltf::Model& file, Model& model) {
    for (const tinygltf::Texture& in : file.textures) {
        // A WebP picture is named by an extension, with a fallback in the usual member.
        int source_index = in.source;
        if (const auto* webp = member(in.extensions, "EXT_texture_webp", "source")) {
            if (webp->IsInt()) source_index = webp->GetNumberAsInt();
        }
        const auto source = optional_index(source_index, model.images.size(), "image");
        const auto sampler = optional_index(in.sampler, file.samplers.size(), "sampler");
        if (!source) return error_of(source);
        if (!sampler) return error_of(sampler);
        TextureDescription texture{*source};
        if (*sampler != no_id) {
            const tinygltf::Sampler& from = file.samplers[*sampler];
            const std::string where = label("sampler", *sampler, from.name);
            const auto wrap_s = convert_wrap(from.wrapS);
            const auto wrap_t = convert_wrap(from.wrapT);
            if (!wrap_s || !wrap_t)
                model.odd.add(where, "its wrapS or wrapT is unknown; the texture repeats");
            texture.wrap_s = wrap_s.value_or(Wrap::repeat);
            texture.wrap_t = wrap_t.value_or(Wrap::repeat);
            texture.nearest = from.magFilter == TINYGLTF_TEXTURE_FILTER_NEAREST;
            if (!texture.nearest && from.magFilter != TINYGLTF_TEXTURE_FILTER_LINEAR &&
                from.magFilter != -1)
                model.odd.add(where, "its magFilter is unknown; linear is used");
        }
        model.textures.push_back(texture);
    }
    return {};
}

namespace {

/// A material's base colour: its factor, and its texture as glTF's textureInfo.
struct BaseColour {
    std::array<double, 4> factor{1, 1, 1, 1};
    std::int64_t texture = -1;
    std::int64_t texcoord = 0;
    const tinygltf::Value* transform = nullptr;  ///< KHR_texture_transform
};

BaseColour metallic_roughness(const tinygltf::PbrMetallicRoughness& pbr, const std::string& where,
                              Oddities& odd) {
    BaseColour colour;
    if (pbr.baseColorFactor.size() == 4)
        std::copy_n(pbr.baseColorFactor.begin(), 4, colour.factor.begin());
    else
        odd.add(where, "baseColorFactor is not four numbers; white is used");
    colour.texture = pbr.baseColorTexture.index;
    colour.texcoord = pbr.baseColorTexture.texCoord;
    const auto transform = pbr.baseColorTexture.extensions.find("KHR_texture_transform");
    if (transform != pbr.baseColorTexture.extensions.end()) colour.transform = &transform->second;
    return colour;
}

/// Reads KHR_materials_pbrSpecularGlossiness; it is preferred if present, as the extension asks.
BaseColour specular_glossiness(const tinygltf::Value& extension, const std::string& where,
                               Oddities& odd) {
    BaseColour colour;
    if (!read_numbers(member(extension, "diffuseFactor"), colour.factor)) {
        odd.add(where, "diffuseFactor is not four numbers; white is used");
        colour.factor = {1, 1, 1, 1};
    }
    const tinygltf::Value* const texture = member(extension, "diffuseTexture");
    if (texture == nullptr) return colour;
    const tinygltf::Value* const index = member(*texture, "index");
    const tinygltf::Value* const texcoord = member(*texture, "texCoord");
    if (index == nullptr || !index->IsInt() || (texcoord != nullptr && !texcoord->IsInt())) {
        odd.add(where,
                "diffuseTexture has no index, or a texCoord that is no number; it is left out");
        return colour;
    }
    colour.texture = index->GetNumberAsInt();
    if (texcoord != nullptr) colour.texcoord = texcoord->GetNumberAsInt();
    if (const auto* extensions = member(*texture, "extensions"))
        colour.transform = member(*extensions, "KHR_texture_transform");
    return colour;
}

void convert_uv_transform(const tinygltf::Value& transform, const std::string& where,
                          MaterialDescription& material, Oddities& odd) {
    float rows[6];
    if (read_uv_transform(transform, rows, material.texcoord))
        std::copy_n(rows, 6, material.uv_transform.begin());
    else
        odd.add(where, "KHR_texture_transform has missing or invalid numbers; it is ignored");
}

}  // namespace

/// The extension's text turns the UVs
/// counter-clockwise as seen on the image, whose v runs down: u' = c u + s v. (Its GLSL snippet has
/// the other sign; viewers follow the text and the Khronos test model.)
bool read_uv_transform(const tinygltf::Value& transform, float (&rows)[6],
                       std::uint32_t& texcoord) {
    std::array<double, 2> offset{0, 0};
    std::array<double, 2> scale{1, 1};
    double rotation = 0;
    std::uint32_t set = texcoord;
    bool valid = read_numbers(member(transform, "offset"), offset) &&
                 read_numbers(member(transform, "scale"), scale);
    if (const auto* value = member(transform, "rotation")) {
        valid = valid && value->IsNumber();
        if (valid) rotation = value->GetNumberAsDouble();
    }
    if (const auto* value = member(transform, "texCoord")) {
        valid = valid && value->IsInt() && value->GetNumberAsInt() >= 0;
        if (valid) set = static_cast<std::uint32_t>(value->GetNumberAsInt());
    }
    const double c = std::cos(rotation);
    const double s = std::sin(rotation);
    const double map[6] = {c * scale[0],  s * scale[1], offset[0],
                           -s * scale[0], c * scale[1], offset[1]};
    for (const double x : map) valid = valid && std::isfinite(static_cast<float>(x));
    if (!valid) return false;
    for (std::size_t i = 0; i < 6; ++i) rows[i] = static_cast<float>(map[i]);
    texcoord = set;
    return true;
}

Result<void> convert_materials(tinygltf::Model& file, Model& model) {
    for (const tinygltf::Material& in : file.materials) {
        MaterialDescription material;
        material.name = one_line(in.name);
        material.double_sided = in.doubleSided;
        const std::string where = label("material", model.materials.size(), in.name);
        if (in.alphaMode == "MASK")
            material.alpha_mode = AlphaMode::mask;
        else if (in.alphaMode == "BLEND")
            material.alpha_mode = AlphaMode::blend;
        else if (in.alphaMode != "OPAQUE")
            model.odd.add(where, "alphaMode is none of OPAQUE, MASK and BLEND; OPAQUE is used");
        if (const auto cutoff = static_cast<float>(in.alphaCutoff);
            std::isfinite(cutoff) && cutoff >= 0)
            material.cutoff = cutoff;
        else
            model.odd.add(where, "alphaCutoff is negative or not finite; 0.5 is used");
        const auto extension = in.extensions.find("KHR_materials_pbrSpecularGlossiness");
        const BaseColour colour =
            extension == in.extensions.end()
                ? metallic_roughness(in.pbrMetallicRoughness, where, model.odd)
                : specular_glossiness(extension->second, where, model.odd);
        for (int i = 0; i < 4; ++i)
            material.base_colour[i] =
                static_cast<float>(colour.factor[static_cast<std::size_t>(i)]);
        if (glm::any(glm::isnan(material.base_colour)) ||
            glm::any(glm::isinf(material.base_colour))) {
            model.odd.add(where, "its base colour factor is not finite; white is used");
            material.base_colour = Vec4(1);
        } else if (const Vec4 within = glm::clamp(material.base_colour, 0.0F, 1.0F);
                   within != material.base_colour) {
            model.odd.add(where,
                          "its base colour factor is not within 0 and 1; the nearest colour "
                          "within is used");
            material.base_colour = within;
        }
        const auto texture = optional_index(colour.texture, model.textures.size(), "texture");
        if (!texture) return error_of(texture);
        material.texture = *texture;
        if (colour.texcoord < 0) model.odd.add(where, "texCoord is negative; 0 is used");
        material.texcoord = static_cast<std::uint32_t>(std::max<std::int64_t>(colour.texcoord, 0));
        if (colour.transform != nullptr)
            convert_uv_transform(*colour.transform, where, material, model.odd);
        if (auto done = convert_surface(in, where, model, material); !done) return done;
        model.materials.push_back(std::move(material));
    }
    return {};
}

}  // namespace raynest::gltf
