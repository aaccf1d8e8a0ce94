#include "engine/assets/formats/mtl.h"

#include "engine/assets/formats/obj_names.h"
#include "engine/assets/formats/text_reader.h"
#include "engine/assets/images/image.h"

#include <algorithm>
#include <utility>

namespace raynest {
namespace {

constexpr std::size_t warnings_max = 16;
constexpr std::size_t materials_max = 1 << 20;

void warn(FileContent& content, std::string text) {
    if (content.warnings.size() < warnings_max) content.warnings.push_back(std::move(text));
}

}  // namespace

Result<void> MtlReader::read(std::string_view name) {
    const std::string shown = one_line(name, 80);
    const auto file = file_of_name(obj_, name);
    if (!file) {
        warn(
            content_,
            fmt::format("mtllib '{}' leaves the scene's folder or is no file's name: put it beside "
                        "the .obj",
                        shown));
        return {};
    }
    if (!read_.insert(*file).second) return {};  // some programs name it for each object
    const auto bytes = files_.read(*file);
    if (!bytes) return tl::unexpected<Error>(bytes.error());
    if (bytes->data() == nullptr) {
        warn(content_,
             fmt::format("mtllib '{}' is missing; its materials are the default one", shown));
        return {};
    }
    return read_lines(*file, *bytes);
}

Result<void> MtlReader::read_lines(const std::string& file, std::span<const std::byte> bytes) {
    TextReader text(bytes);
    const auto bad = [&](std::string_view key) -> Result<void> {
        Error error =
            text.error(fmt::format("{} is no number, which {} needs", text.next_word(), key));
        error.message = fmt::format("'{}' {}", one_line(file, 80), error.message);
        return tl::unexpected<Error>(std::move(error));
    };
    MaterialDescription unused;
    MaterialDescription* material = &unused;
    for (; !text.at_end(); text.next_line()) {
        const std::string_view key = text.word();
        if (key == "newmtl") {
            const std::string name(front_of(text.rest(), 1024));
            if (materials_.size() >= materials_max)
                return fail(
                    ErrorCode::limit_exceeded,
                    fmt::format("'{}' has over {} materials", one_line(file, 80), materials_max));
            const auto [known, is_new] =
                materials_.emplace(name, static_cast<std::uint32_t>(content_.materials.size()));
            if (is_new) content_.materials.push_back({.name = name});
            material = is_new ? &content_.materials[known->second] : &unused;  // the first counts
        } else if (key == "Kd" || key == "Ke") {
            glm::dvec3 colour;
            if (!text.number(colour.x)) {
                const std::string next = text.next_word();
                if (next == "'xyz'" || next == "'spectral'") continue;
                return bad(key);
            }
            if (!text.number(colour.y) || !text.number(colour.z)) colour = glm::dvec3(colour.x);
            const double most = key == "Kd" ? 1.0 : 1e6;
            for (int axis = 0; axis < 3; ++axis)
                colour[axis] = colour[axis] > 0 ? std::min(colour[axis], most) : 0;
            if (key == "Ke")
                material->surface.emission = Vec3(colour);
            else
                material->base_colour = Vec4(Vec3(colour), material->base_colour.w);
        } else if (key == "d" || key == "Tr") {
            double value = 0;
            if (!text.number(value)) {
                if (text.word() != "-halo" || !text.number(value)) return bad(key);
            }
            const double alpha = std::clamp(key == "d" ? value : 1 - value, 0.0, 1.0);
            material->base_colour.w = static_cast<float>(alpha);
            material->alpha_mode = alpha < 1 ? AlphaMode::blend : AlphaMode::opaque;
        } else if (key == "map_Kd") {
            material->texture = texture(file, picture_of_map(text.rest()));
        }
    }
    return {};
}

std::uint32_t MtlReader::texture(const std::string& mtl, std::string_view name) {
    const std::string shown = one_line(name, 80);
    const auto file = file_of_name(mtl, name);
    if (!file) {
        warn(content_,
             fmt::format("the picture '{}' leaves the scene's folder or is no file's name: put it "
                         "beside the .mtl",
                         shown));
        return no_id;
    }
    const auto [known, is_new] = textures_.emplace(*file, no_id);
    if (!is_new) return known->second;
    const auto bytes = files_.read(*file);
    if (!bytes || bytes->data() == nullptr) {
        warn(content_,
             fmt::format("the picture '{}' is missing; its materials are shown without it", shown));
        return no_id;
    }
    auto image = decode_image(*bytes, limits_.image_side_max,
                              std::min(limits_.image_bytes_max, image_bytes_left_));
    if (!image) {
        warn(content_, fmt::format("the picture '{}': {}; its materials are shown without it",
                                   shown, image.error().message));
        return no_id;
    }
    image_bytes_left_ -= image->rgba.size();
    TextureDescription texture;
    texture.image = static_cast<std::uint32_t>(content_.images.size());
    content_.images.push_back(std::move(*image));
    content_.textures.push_back(texture);
    return known->second = static_cast<std::uint32_t>(content_.textures.size() - 1);
}

std::uint32_t MtlReader::find(std::string_view name) {
    const std::string kept(front_of(name, 1024));
    const auto [known, is_new] =
        materials_.emplace(kept, static_cast<std::uint32_t>(content_.materials.size()));
    if (is_new) {
        content_.materials.push_back({.name = kept});
        warn(content_, fmt::format("no MTL file has the material '{}'; it is the default one",
                                   one_line(kept, 80)));
    }
    return known->second;
}

}  // namespace raynest
