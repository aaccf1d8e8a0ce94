// Textures and materials as tinygltf read them -> a Model's, checked.
#include "engine/assets/gltf_convert.h"
#include "engine/assets/gltf_names.h"

#include <fmt/format.h>

#include <cmath>
#include <optional>

namespace raynest::gltf {
namespace {

Result<Wrap> convert_wrap(int value) {
    switch (value) {
        case TINYGLTF_TEXTURE_WRAP_REPEAT:
            return Wrap::repeat;
        case TINYGLTF_TEXTURE_WRAP_CLAMP_TO_EDGE:
            return Wrap::clamp;
        case TINYGLTF_TEXTURE_WRAP_MIRRORED_REPEAT:
            return Wrap::mirror;
        default:
            return fail(ErrorCode::scene_invalid,
                        fmt::format("sampler wrap mode {} is unknown", value));
    }
}

}  // namespace

Result<void> convert_textures(tinygltf::Model& file, Model& model) {
    for (const tinygltf::Texture& in : file.textures) {
        // A WebP picture stands in an extension, with a fallback in the usual place.
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
            const auto wrap_s = convert_wrap(from.wrapS);
            const auto wrap_t = convert_wrap(from.wrapT);
            if (!wrap_s) return error_of(wrap_s);
            if (!wrap_t) return error_of(wrap_t);
            texture.wrap_s = *wrap_s;
            texture.wrap_t = *wrap_t;
            texture.nearest = from.magFilter == TINYGLTF_TEXTURE_FILTER_NEAREST;
        }
        model.textures.push_back(texture);
    }
    return {};
}

namespace {

/// A member of a JSON object, or null.
const tinygltf::Value* member(const tinygltf::Value& object, const char* name) {
    return object.Has(name) ? &object.Get(name) : nullptr;
}

/// Numbers of an array; false where it is there and holds something else.
template <std::size_t count>
bool read_numbers(const tinygltf::Value* value, std::array<double, count>& numbers) {
    if (value == nullptr) return true;
    if (!value->IsArray() || value->ArrayLen() != count) return false;
    for (std::size_t i = 0; i < count; ++i) {
        const tinygltf::Value& number = value->Get(static_cast<int>(i));
        if (!number.IsNumber()) return false;
        numbers[i] = number.GetNumberAsDouble();
    }
    return true;
}

/// A material's base colour: its factor, and its texture as glTF's textureInfo.
struct BaseColour {
    std::array<double, 4> factor{1, 1, 1, 1};
    std::int64_t texture = -1;
    std::int64_t texcoord = 0;
    const tinygltf::Value* transform = nullptr;  ///< KHR_texture_transform
};

Result<BaseColour> metallic_roughness(const tinygltf::PbrMetallicRoughness& pbr,
                                      const std::string& where) {
    BaseColour colour;
    if (pbr.baseColorFactor.size() != 4) {
        return fail(ErrorCode::scene_invalid, where + ": baseColorFactor must be four numbers");
    }
    std::copy_n(pbr.baseColorFactor.begin(), 4, colour.factor.begin());
    colour.texture = pbr.baseColorTexture.index;
    colour.texcoord = pbr.baseColorTexture.texCoord;
    const auto transform = pbr.baseColorTexture.extensions.find("KHR_texture_transform");
    if (transform != pbr.baseColorTexture.extensions.end()) colour.transform = &transform->second;
    return colour;
}

/// KHR_materials_pbrSpecularGlossiness: where it stands it is preferred, as the extension asks.
Result<BaseColour> specular_glossiness(const tinygltf::Value& extension, const std::string& where) {
    BaseColour colour;
    const auto refuse = [&](const char* why) {
        return fail(ErrorCode::scene_invalid,
                    fmt::format("{}: KHR_materials_pbrSpecularGlossiness: {}", where, why));
    };
    if (!read_numbers(member(extension, "diffuseFactor"), colour.factor))
        return refuse("diffuseFactor must be four numbers");
    const tinygltf::Value* const texture = member(extension, "diffuseTexture");
    if (texture == nullptr) return colour;
    const tinygltf::Value* const index = member(*texture, "index");
    if (index == nullptr || !index->IsInt()) return refuse("diffuseTexture names no texture");
    colour.texture = index->GetNumberAsInt();
    if (const auto* texcoord = member(*texture, "texCoord")) {
        if (!texcoord->IsInt()) return refuse("texCoord must be a number");
        colour.texcoord = texcoord->GetNumberAsInt();
    }
    if (const auto* extensions = member(*texture, "extensions"))
        colour.transform = member(*extensions, "KHR_texture_transform");
    return colour;
}

/// KHR_texture_transform as two rows of an affine map. The extension's text turns the UVs counter-
/// clockwise as seen on the image, whose v runs down: u' = c u + s v. (Its GLSL snippet has the
/// other sign; viewers follow the text and the Khronos test model.)
Result<void> convert_uv_transform(const tinygltf::Value& transform, MaterialDescription& material) {
    std::array<double, 2> offset{0, 0};
    std::array<double, 2> scale{1, 1};
    double rotation = 0;
    bool valid = read_numbers(member(transform, "offset"), offset) &&
                 read_numbers(member(transform, "scale"), scale);
    if (const auto* value = member(transform, "rotation")) {
        valid = valid && value->IsNumber();
        if (valid) rotation = value->GetNumberAsDouble();
    }
    if (const auto* value = member(transform, "texCoord")) {
        valid = valid && value->IsInt() && value->GetNumberAsInt() >= 0;
        if (valid) material.texcoord = static_cast<std::uint32_t>(value->GetNumberAsInt());
    }
    const double c = std::cos(rotation);
    const double s = std::sin(rotation);
    const double rows[6] = {c * scale[0],  s * scale[1], offset[0],
                            -s * scale[0], c * scale[1], offset[1]};
    for (std::size_t i = 0; i < 6 && valid; ++i) {
        material.uv_transform[i] = static_cast<float>(rows[i]);
        valid = std::isfinite(material.uv_transform[i]);
    }
    if (valid) return {};
    return fail(ErrorCode::scene_invalid,
                "a KHR_texture_transform does not hold the numbers it must");
}

}  // namespace

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
        else if (in.alphaMode != "OPAQUE") {
            return fail(ErrorCode::scene_invalid, where + " has an unknown alphaMode");
        }
        const auto cutoff = finite(in.alphaCutoff, where + ": alphaCutoff");
        if (!cutoff) return error_of(cutoff);
        if (*cutoff < 0)
            return fail(ErrorCode::scene_invalid, where + " has a negative alphaCutoff");
        material.cutoff = *cutoff;
        const auto extension = in.extensions.find("KHR_materials_pbrSpecularGlossiness");
        const auto colour = extension == in.extensions.end()
                                ? metallic_roughness(in.pbrMetallicRoughness, where)
                                : specular_glossiness(extension->second, where);
        if (!colour) return error_of(colour);
        for (int i = 0; i < 4; ++i) {
            const auto value = finite(colour->factor[static_cast<std::size_t>(i)],
                                      where + ": the factor of its base colour");
            if (!value) return error_of(value);
            material.base_colour[i] = *value;
        }
        const auto texture = optional_index(colour->texture, model.textures.size(), "texture");
        if (!texture) return error_of(texture);
        material.texture = *texture;
        if (colour->texcoord < 0) {
            return fail(ErrorCode::scene_invalid, where + " has a negative texCoord");
        }
        material.texcoord = static_cast<std::uint32_t>(colour->texcoord);
        if (colour->transform != nullptr) {
            if (auto done = convert_uv_transform(*colour->transform, material); !done) return done;
        }
        model.materials.push_back(std::move(material));
    }
    return {};
}

}  // namespace raynest::gltf
