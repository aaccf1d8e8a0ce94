// Materials, and the pictures that they use. No other picture is decoded.
//
// A missing or damaged texture does not stop a scene: the material is used without it, and the
// count and the reason are reported. Lack of memory is an error: otherwise a busy machine would
// build a different scene from the same file.
#include "engine/assets/gltf/describe.h"
#include "engine/assets/images/image.h"
#include "engine/assets/input/messages.h"

#include <fmt/format.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <optional>
#include <utility>

namespace raynest::gltf {
namespace {

/// Limit for all pictures of a file together, as a multiple of the limit for one.
constexpr std::uint64_t images_per_file = 4;

/// A larger picture is decoded alone, so that few threads hold little more than one thread would.
constexpr std::uint64_t decoded_beside_others_max = 64U << 20;

class PictureReader {
public:
    PictureReader(const Model& model, const ImportLimits& limits, SceneDescription& scene)
        : model_(model),
          limits_(limits),
          scene_(scene),
          bytes_left_(limits.image_bytes_max * images_per_file),
          read_(model.images.size(), not_read),
          users_(model.images.size()),
          decoded_(model.images.size()) {}

    /// Decodes the pictures of textures on all threads. A picture that fails here is decoded again
    /// by `read`, in the order of the file, which alone decides what is reported.
    void decode(const std::vector<bool>& texture_is_used) {
        std::vector<bool> wanted(read_.size());
        for (std::size_t i = 0; i < texture_is_used.size(); ++i) {
            const std::uint32_t image = model_.textures[i].image;
            if (texture_is_used[i] && image != no_id)
                wanted[image] = model_.images[image].fault.empty();
        }
        std::atomic<std::uint64_t> bytes{0};
        tbb::parallel_for(std::size_t{0}, wanted.size(), [&](std::size_t i) {
            if (!wanted[i] || bytes >= bytes_left_) return;
            auto picture =
                decode_image(model_.images[i].bytes, limits_.image_side_max,
                             std::min(limits_.image_bytes_max, decoded_beside_others_max));
            if (!picture) return;
            bytes += picture->rgba.size();
            decoded_[i] = std::move(*picture);
        });
    }

    /// Counts a material that uses the picture of a texture.
    void add_user(std::uint32_t texture, std::uint32_t material) {
        const std::uint32_t image = model_.textures[texture].image;
        if (image == no_id) return;
        Users& users = users_[image];
        if (users.last != material) ++users.count;
        users.last = material;
    }

    /// Returns the index of a texture's decoded picture in the scene, or no_id if there is none.
    /// `material` is the first that uses it, for a message.
    Result<std::uint32_t> read(std::uint32_t texture, const std::string& material) {
        const std::uint32_t image = model_.textures[texture].image;
        if (image == no_id)
            return missing(fmt::format("texture {} names no picture; {} is shown without it",
                                       texture, material));
        if (read_[image] != not_read) return read_[image];
        const Image& from = model_.images[image];
        const std::string name = label("picture", image, from.name);
        const std::uint32_t others = users_[image].count - 1;
        const std::string without = others == 0
                                        ? fmt::format("; {} is shown without it", material)
                                        : fmt::format("; {} and {} are shown without it", material,
                                                      counted(others, "other", "others"));
        if (!from.fault.empty()) return read_[image] = missing(name + ' ' + from.fault + without);
        std::optional<ImageDescription>& known = decoded_[image];
        auto picture = known && known->rgba.size() <= bytes_left_
                           ? Result<ImageDescription>(std::move(*known))
                           : decode_image(from.bytes, limits_.image_side_max,
                                          std::min(limits_.image_bytes_max, bytes_left_));
        known.reset();
        if (!picture && picture.error().code == ErrorCode::out_of_memory)
            return blame(name + ':', picture.error());
        if (!picture) {
            std::string why = picture.error().message;
            if (picture.error().code == ErrorCode::limit_exceeded &&
                bytes_left_ < limits_.image_bytes_max)
                why += fmt::format("; the scene's other pictures take the rest of {} MiB",
                                   (limits_.image_bytes_max * images_per_file) >> 20);
            return read_[image] = missing(name + ": " + why + without);
        }
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
    /// The materials that use a picture; `last` is the one that was counted last.
    struct Users {
        std::uint32_t count = 0;
        std::uint32_t last = no_id;
    };
    std::vector<Users> users_;
    std::vector<std::optional<ImageDescription>> decoded_;  ///< per picture, until it is read
};

enum class Purpose : std::uint8_t { base, colour, data };

/// Adds textures to the scene: each once for what it is used for.
class TextureReader {
public:
    TextureReader(const Model& model, const ImportLimits& limits, SceneDescription& scene)
        : model_(model),
          scene_(scene),
          pictures_(model, limits, scene) {
        for (auto& list : texture_of_) list.assign(model.textures.size(), not_read);
        std::vector<bool> used(model.textures.size());
        for (std::uint32_t m = 0; m < model.materials.size(); ++m) {
            const MaterialDescription& material = model.materials[m];
            const SurfaceRecord& surface = material.surface;
            const auto use = [&](std::uint32_t texture) {
                if (texture == no_id) return;
                used[texture] = true;
                pictures_.add_user(texture, m);
            };
            use(material.texture);
            for (const TextureUse& of : surface.textures) use(of.texture);
        }
        pictures_.decode(used);
    }

    /// Replaces a texture of the model by that of the scene; no_id where it has no picture.
    /// Messages name the material as `material`.
    Result<void> read(const std::string& material, std::uint32_t& texture, std::uint32_t& texcoord,
                      Purpose purpose) {
        if (texture != no_id) {
            std::uint32_t& known = texture_of_[static_cast<std::size_t>(purpose)][texture];
            if (known == not_read) {
                const auto image = pictures_.read(texture, material);
                if (!image) return error_of(image);
                known = no_id;
                if (*image != no_id) {
                    known = static_cast<std::uint32_t>(scene_.textures.size());
                    scene_.textures.push_back(model_.textures[texture]);
                    scene_.textures.back().image = *image;
                    scene_.textures.back().linear = purpose == Purpose::data;
                    scene_.textures.back().alpha = purpose == Purpose::base;
                }
            }
            texture = known;
            if (texture != no_id && texcoord > 1) {
                leave_out(scene_, "textures",
                          fmt::format("{} uses TEXCOORD_{}; only sets 0 and 1 are read; "
                                      "its texture is left out",
                                      material, texcoord));
                texture = no_id;
            }
        }
        if (texture == no_id) texcoord = 0;
        return {};
    }
    void warn_of_unused() { pictures_.warn_of_unused(); }

private:
    static constexpr std::uint32_t not_read = no_id - 1;
    const Model& model_;
    SceneDescription& scene_;
    PictureReader pictures_;
    std::array<std::vector<std::uint32_t>, 3> texture_of_;  ///< by Purpose
};

}  // namespace

Result<void> read_materials(const Model& model, const ImportLimits& limits,
                            SceneDescription& scene) {
    TextureReader textures(model, limits, scene);
    for (const MaterialDescription& from : model.materials) {
        MaterialDescription material = from;
        const std::string where = label("material", scene.materials.size(), from.name);
        const auto read = [&](std::uint32_t& texture, std::uint32_t& texcoord, Purpose purpose) {
            return textures.read(where, texture, texcoord, purpose);
        };
        if (auto done = read(material.texture, material.texcoord, Purpose::base); !done)
            return done;
        SurfaceRecord& surface = material.surface;
        for (std::size_t i = 0; i < surface_textures; ++i) {
            TextureUse& use = surface.textures[i];
            const Purpose purpose =
                has_colours(static_cast<TextureSlot>(i)) ? Purpose::colour : Purpose::data;
            if (auto done = read(use.texture, use.texcoord, purpose); !done) return done;
        }
        // Without its texture a factor alone would light up or turn to metal what should not.
        const auto lacks = [&](TextureSlot slot) {
            return from.surface.use(slot).texture != no_id && surface.use(slot).texture == no_id;
        };
        if (lacks(TextureSlot::emission)) surface.emission = Vec3(0);
        if (lacks(TextureSlot::metallic_roughness)) surface.metallic = 0;
        scene.materials.push_back(std::move(material));
    }
    textures.warn_of_unused();
    return {};
}

}  // namespace raynest::gltf
