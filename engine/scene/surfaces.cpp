// Materials, textures and cameras of a checked description -> records.
#include "engine/scene/content.h"

#include <cmath>

namespace raynest {
namespace {

/// A camera's pose without the scale of its node (CONTRACT.md §5): -Z and +Y keep their directions
/// as far as they agree, +X follows. An unusable node looks along -Z of the world.
Transform without_scale(const Transform& t) {
    const auto column = [&](std::size_t c) {
        return glm::dvec3(static_cast<double>(t.m[c]), static_cast<double>(t.m[4 + c]),
                          static_cast<double>(t.m[8 + c]));
    };
    const glm::dvec3 z = glm::normalize(column(2));
    const glm::dvec3 y = glm::normalize(column(1) - z * glm::dot(z, column(1)));
    const glm::dvec3 x = glm::cross(y, z);
    const bool usable = std::isfinite(glm::dot(x + y + z, glm::dvec3(1)));
    Transform pose;
    for (int row = 0; row < 3; ++row) {
        const auto at = 4 * static_cast<std::size_t>(row);
        if (usable) {
            pose.m[at] = static_cast<float>(x[row]);
            pose.m[at + 1] = static_cast<float>(y[row]);
            pose.m[at + 2] = static_cast<float>(z[row]);
        }
        pose.m[at + 3] = t.m[at + 3];
    }
    return pose;
}

}  // namespace

void add_surfaces(const SceneDescription& description, Content& content) {
    struct Planes {
        std::uint64_t colour = no_offset;
        std::uint64_t alpha = no_offset;
    };
    std::vector<Planes> planes(description.images.size());
    for (const TextureDescription& texture : description.textures) {
        const ImageDescription& image = description.images[texture.image];
        Planes& shared = planes[texture.image];
        if (shared.colour == no_offset) {
            shared = {content.attributes.add(image.rgba), content.attributes.add_alpha(image.rgba)};
        }
        content.textures.push_back({shared.colour, shared.alpha, image.width, image.height,
                                    texture.wrap_s, texture.wrap_t, texture.nearest ? 1U : 0U, 0});
    }

    for (const MaterialDescription& material : description.materials) {
        MaterialRecord record{};
        record.base_colour = material.base_colour;
        for (std::size_t i = 0; i < 6; ++i) record.uv_transform[i] = material.uv_transform[i];
        record.texture = material.texture;
        record.texcoord = material.texcoord;
        record.alpha_mode = material.alpha_mode;
        record.cutoff = material.cutoff;
        record.double_sided = material.double_sided ? 1 : 0;
        record.name = content.names.add(material.name);
        content.materials.push_back(record);
    }
}

void add_cameras(const SceneDescription& description, Content& content) {
    for (const CameraDescription& camera : description.cameras) {
        content.cameras.push_back({without_scale(camera.to_world), camera.yfov, camera.aspect,
                                   content.names.add(camera.name), 0});
    }
}

}  // namespace raynest
