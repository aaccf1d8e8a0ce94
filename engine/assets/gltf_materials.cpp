// Materials, and the pictures that their base colours need. No other picture is decoded.
//
// A missing or damaged texture does not stop a scene: the material is used without it, and the
// count and the reason are reported. Lack of memory is an error: otherwise a busy machine would
// build a different scene from the same file.
#include "engine/assets/gltf_model.h"
#include "engine/assets/gltf_names.h"
#include "engine/assets/image.h"

#include <fmt/format.h>

namespace raynest::gltf {
namespace {

/// Limit for all pictures of a file together, as a multiple of the limit for one.
constexpr std::uint64_t images_per_file = 4;

class PictureReader {
public:
    PictureReader(const Model& model, const ImportLimits& limits, SceneDescription& scene)
        : model_(model),
          limits_(limits),
          scene_(scene),
          bytes_left_(limits.image_bytes_max * images_per_file),
          read_(model.images.size(), not_read) {}

    /// Returns the index of a texture's decoded picture in the scene, or no_id if there is none.
    Result<std::uint32_t> read(std::uint32_t texture) {
        const std::uint32_t image = model_.textures[texture].image;
        if (image == no_id)
            return missing(fmt::format("texture {} names no picture; it is left out", texture));
        if (read_[image] != not_read) return read_[image];
        const Image& from = model_.images[image];
        const std::string name = label("texture", image, from.name);
        if (!from.fault.empty()) return read_[image] = missing(name + ' ' + from.fault);
        auto picture = decode_image(from.bytes, limits_.image_side_max,
                                    std::min(limits_.image_bytes_max, bytes_left_));
        if (!picture && picture.error().code == ErrorCode::out_of_memory)
            return blame(name + ':', picture.error());
        if (!picture) return read_[image] = missing(name + ": " + picture.error().message);
        bytes_left_ -= picture->rgba.size();
        scene_.images.push_back(std::move(*picture));
        return read_[image] = static_cast<std::uint32_t>(scene_.images.size() - 1);
    }

    /// Warns of faulty pictures that no material uses.
    void warn_of_unused() {
        for (std::uint32_t i = 0; i < read_.size(); ++i) {
            const Image& image = model_.images[i];
            if (read_[i] != not_read || image.fault.empty()) continue;
            leave_out(scene_, "unused_pictures",
                      label("unused picture", i, image.name) + ' ' + image.fault);
        }
    }

private:
    static constexpr std::uint32_t not_read = no_id - 1;

    std::uint32_t missing(std::string why) {
        leave_out(scene_, "textures", std::move(why));
        return no_id;
    }

    const Model& model_;
    const ImportLimits& limits_;
    SceneDescription& scene_;
    std::uint64_t bytes_left_;
    std::vector<std::uint32_t> read_;
};

}  // namespace

Result<void> read_materials(const Model& model, const ImportLimits& limits,
                            SceneDescription& scene) {
    PictureReader pictures(model, limits, scene);
    std::vector<std::uint32_t> texture_of(model.textures.size(), no_id);
    std::vector<bool> texture_read(model.textures.size(), false);
    for (const MaterialDescription& from : model.materials) {
        MaterialDescription material = from;
        if (from.texture != no_id && !texture_read[from.texture]) {
            texture_read[from.texture] = true;
            TextureDescription texture = model.textures[from.texture];
            const auto image = pictures.read(from.texture);
            if (!image) return error_of(image);
            texture.image = *image;
            if (texture.image != no_id) {
                texture_of[from.texture] = static_cast<std::uint32_t>(scene.textures.size());
                scene.textures.push_back(texture);
            }
        }
        material.texture = from.texture == no_id ? no_id : texture_of[from.texture];
        if (material.texture != no_id && material.texcoord > 1) {
            leave_out(scene, "textures",
                      fmt::format("material '{}' uses TEXCOORD_{}; only sets 0 and 1 are read; its "
                                  "texture is left out",
                                  one_line(material.name, 60), material.texcoord));
            material.texture = no_id;
        }
        if (material.texture == no_id) material.texcoord = 0;
        scene.materials.push_back(std::move(material));
    }
    pictures.warn_of_unused();
    return {};
}

}  // namespace raynest::gltf
