#include "engine/scene/checks/shading_check.h"

#include "engine/scene/checks/arena_check.h"
#include "engine/scene/format.h"
#include "engine/scene/snapshot.h"
#include "engine/scene/texture_levels.h"
#include "engine/shading/types.h"

#include <algorithm>
#include <cmath>
#include <string>

namespace raynest {
namespace {

using format::Section;

bool in_unit(float x) {
    return x >= 0 && x <= 1;
}

bool not_negative(const Vec3& v) {
    const auto sound = [](float x) { return x >= 0 && std::isfinite(x); };
    return sound(v.x) && sound(v.y) && sound(v.z);
}

bool is_sound_use(const TextureUse& use, std::uint64_t textures) {
    return (use.texture == no_id || use.texture < textures) && use.texcoord <= 1 &&
           std::all_of(std::begin(use.uv_transform), std::end(use.uv_transform),
                       [](float x) { return std::isfinite(x); });
}

/// True if the levels from the second on fit in the attributes.
bool has_levels(const TextureRecord& texture, const TextureLevels& levels, std::uint64_t bytes) {
    if (levels.count != level_count(texture.width, texture.height) || levels.linear > 1)
        return false;
    if (levels.count == 1) return levels.offset == no_offset;
    std::uint64_t total = 0;
    std::uint64_t width = texture.width, height = texture.height;
    while (width > 1 || height > 1) {
        width = std::max<std::uint64_t>(width / 2, 1);
        height = std::max<std::uint64_t>(height / 2, 1);
        total += 4 * width * height;
    }
    return levels.offset <= bytes && total <= bytes - levels.offset;
}

bool is_within(float x, float least, float most) {
    return x >= least && x <= most;
}
bool is_within(const Vec3& v, float least, float most) {
    return is_within(v.x, least, most) && is_within(v.y, least, most) &&
           is_within(v.z, least, most);
}

bool is_sound(const Layers& layers) {
    return true
#define RAYNEST_MATERIAL_LAYER_FACTOR(extension, word, Type, name, otherwise, least, most) \
    &&is_within(layers.name, least, most)
#include "engine/shading/material_layers.def"
        ;
}

}  // namespace

bool is_sound(const SurfaceRecord& s, std::uint64_t textures) {
    return in_unit(s.metallic) && in_unit(s.roughness) && std::isfinite(s.normal_scale) &&
           in_unit(s.occlusion_strength) && s.ior > 0 && std::isfinite(s.ior) &&
           in_unit(s.transmission) && s.thickness >= 0 && std::isfinite(s.thickness) &&
           not_negative(s.emission) && s.attenuation_distance >= 0 &&
           std::isfinite(s.attenuation_distance) && not_negative(s.attenuation_colour) &&
           s.unused == 0 && is_sound(s.layers) &&
           std::all_of(std::begin(s.textures), std::end(s.textures),
                       [&](const TextureUse& use) { return is_sound_use(use, textures); });
}

/// Those of its own; what its kind does not name is 0.
bool has_sound_numbers(const LightRecord& light) {
    const auto numbers = light_numbers(light.kind);
    for (std::size_t i = 0; i < numbers.size(); ++i)
        if (!is_within(light.own[i], numbers[i].least, numbers[i].most)) return false;
    return std::all_of(light.own + numbers.size(), std::end(light.own),
                       [](float x) { return x == 0; });
}

bool is_sound(const LightRecord& light) {
    const Vec3& p = light.position;
    const float length2 = glm::dot(light.direction, light.direction);
    return std::isfinite(p.x) && std::isfinite(p.y) && std::isfinite(p.z) && length2 > 0.99F &&
           length2 < 1.01F && not_negative(light.intensity) && light.range >= 0 &&
           std::isfinite(light.range) && has_sound_numbers(light);
}

Result<void> check_shading(std::span<const std::byte> arena, const SceneView& view) {
    const auto size = [&](Section section) { return format::section_size(arena.data(), section); };
    if (size(Section::surfaces) != view.material_count ||
        size(Section::geometry_shading) != view.geometry_count ||
        size(Section::texture_levels) != view.texture_count)
        return broken_arena("its materials, geometries or textures are not those of shading");
    if (size(Section::lights) > scene_lights_max) return broken_arena("it has too many lights");
    const std::uint64_t bytes = size(Section::attributes);

    const auto* levels = format::section<TextureLevels>(arena.data(), Section::texture_levels);
    for (std::uint32_t i = 0; i < view.texture_count; ++i)
        if (!has_levels(view.textures[i], levels[i], bytes))
            return broken_arena("the levels of texture " + std::to_string(i));

    const auto* surfaces = format::section<SurfaceRecord>(arena.data(), Section::surfaces);
    for (std::uint32_t i = 0; i < view.material_count; ++i)
        if (!is_sound(surfaces[i], view.texture_count))
            return broken_arena("the surface of material " + std::to_string(i));

    const auto* shading = format::section<GeometryShading>(arena.data(), Section::geometry_shading);
    const auto is_run = [&](std::uint64_t offset, std::uint64_t count, std::uint64_t element) {
        return offset == no_offset ||
               (offset % 4 == 0 && offset <= bytes && count <= (bytes - offset) / element);
    };
    for (std::uint32_t i = 0; i < view.geometry_count; ++i) {
        const std::uint64_t vertices = view.geometries[i].vertex_count;
        if (!is_run(shading[i].normals, vertices, sizeof(Vec3)) ||
            !is_run(shading[i].tangents, vertices, sizeof(Vec4)))
            return broken_arena("the normals of geometry " + std::to_string(i));
    }

    const auto* lights = format::section<LightRecord>(arena.data(), Section::lights);
    for (std::uint64_t i = 0; i < size(Section::lights); ++i)
        if (!is_sound(lights[i]) || lights[i].name >= size(Section::names))
            return broken_arena("light " + std::to_string(i));
    return {};
}

}  // namespace raynest
