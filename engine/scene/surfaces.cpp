// Materials, textures and cameras of a checked description -> records.
#include "engine/scene/camera_pose.h"
#include "engine/scene/content.h"
#include "engine/scene/texture_levels.h"

#include <algorithm>
#include <array>

namespace raynest {
void add_surfaces(const SceneDescription& description, Content& content) {
    struct Planes {
        std::uint64_t colour = no_offset;
        std::uint64_t alpha = no_offset;
        std::array<TextureLevels, 2> levels;  ///< for colours, for data
    };
    std::vector<Planes> planes(description.images.size());
    for (const TextureDescription& texture : description.textures) {
        const ImageDescription& image = description.images[texture.image];
        Planes& shared = planes[texture.image];
        if (shared.colour == no_offset) shared.colour = content.attributes.add(image.rgba);
        if (texture.alpha && shared.alpha == no_offset)
            shared.alpha = content.attributes.add_alpha(image.rgba);
        TextureLevels& levels = shared.levels[texture.linear ? 1 : 0];
        if (levels.offset == no_offset) {
            levels.linear = texture.linear ? 1 : 0;
            levels.count = level_count(image.width, image.height);
            levels.offset = content.attributes.add(
                content.smaller.emplace_back(smaller_levels(image, texture.linear)));
        }
        content.textures.push_back({shared.colour, texture.alpha ? shared.alpha : no_offset,
                                    image.width, image.height, texture.wrap_s, texture.wrap_t,
                                    texture.nearest ? 1U : 0U, 0});
        content.texture_levels.push_back(levels);
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
        content.surfaces.push_back(material.surface);
    }
}

void add_lights(const SceneDescription& description, Content& content) {
    for (const LightDescription& light : description.lights) {
        content.lights.push_back(light.light);
        content.lights.back().name = content.names.add(light.name);
    }
}

void add_cameras(const SceneDescription& description, Content& content) {
    for (const CameraDescription& camera : description.cameras) {
        std::array<double, 12> to_world{};
        std::copy_n(camera.to_world.m.begin(), 12, to_world.begin());
        // A pose without a direction looks along the world's -Z from its position.
        Transform along_z;
        for (const std::size_t i : {3U, 7U, 11U}) along_z.m[i] = camera.to_world.m[i];
        content.cameras.push_back({camera_pose(to_world).value_or(along_z), camera.yfov,
                                   camera.aspect, content.names.add(camera.name), camera.ymag});
    }
}

}  // namespace raynest
