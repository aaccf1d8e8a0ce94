// Data that shading reads beside the views of the kernels: records in the arena, each with the
// index of the material, geometry or texture that it belongs to. Kernels never read them.
#pragma once

#include "engine/geometry/up_axis.h"
#include "engine/geometry/views.h"
#include "engine/math/vec.h"

#include <cstddef>
#include <cstdint>
#include <type_traits>

namespace raynest {

/// A texture as a material uses it, with glTF's set of coordinates and KHR_texture_transform.
struct TextureUse {
    std::uint32_t texture = no_id;
    std::uint32_t texcoord = 0;
    float uv_transform[6] = {1, 0, 0, 0, 1, 0};  ///< as MaterialRecord::uv_transform
};

/// The textures of a material. Only that of the base colour is not in its SurfaceRecord.
enum class TextureSlot : std::uint8_t {
    metallic_roughness,
    normal,
    occlusion,
    emission,
    transmission,
#define RAYNEST_MATERIAL_LAYER_MAP(extension, word, slot) slot,
#include "engine/shading/material_layers.def"
    base,
};
inline constexpr auto surface_textures = static_cast<std::size_t>(TextureSlot::base);

/// The channels of a texel, and its colour.
namespace texel {
inline float red(const Vec4& t) {
    return t.x;
}
inline float green(const Vec4& t) {
    return t.y;
}
inline float blue(const Vec4& t) {
    return t.z;
}
inline float alpha(const Vec4& t) {
    return t.w;
}
inline Vec3 colour(const Vec4& t) {
    return Vec3(t);
}
}  // namespace texel

/// True if a texture holds colours, in sRGB; others hold data.
[[nodiscard]] constexpr bool has_colours(TextureSlot slot) {
    switch (slot) {
        case TextureSlot::base:
        case TextureSlot::emission:
            return true;
#define RAYNEST_MATERIAL_LAYER_TEXTURE(extension, word, slot, factor, channel) \
    case TextureSlot::slot:                                                    \
        return std::is_same_v<decltype(texel::channel(Vec4())), Vec3>;
#include "engine/shading/material_layers.def"
        default:
            return false;
    }
}

/// Factors of the extensions in material_layers.def. The defaults add nothing.
struct Layers {
#define RAYNEST_MATERIAL_LAYER_FACTOR(extension, word, Type, name, otherwise, least, most) \
    Type name{otherwise};
#include "engine/shading/material_layers.def"
};

/// How a material scatters and emits light; base colour and alpha are in its MaterialRecord.
struct SurfaceRecord {
    std::uint32_t kind = 0;  ///< shading_type() of a name of shading/materials.def; 0: glTF's own
    float metallic = 0;
    float roughness = 1;
    float normal_scale = 1;
    float occlusion_strength = 1;
    float ior = 1.5F;
    float transmission = 0;
    float thickness = 0;             ///< 0: a sheet; else light is refracted into a solid
    Vec3 emission{0};                ///< factor x strength
    float attenuation_distance = 0;  ///< 0: the solid absorbs nothing
    Vec3 attenuation_colour{1};      ///< what is left of white after attenuation_distance
    std::uint32_t unused = 0;
    Layers layers;
    TextureUse textures[surface_textures];

    [[nodiscard]] TextureUse& use(TextureSlot slot) {
        return textures[static_cast<std::size_t>(slot)];
    }
    [[nodiscard]] const TextureUse& use(TextureSlot slot) const {
        return textures[static_cast<std::size_t>(slot)];
    }
    [[nodiscard]] bool has(TextureSlot slot) const { return use(slot).texture != no_id; }
};
// No padding (scene/format.h).
static_assert(sizeof(SurfaceRecord) ==
              16 * sizeof(float) + sizeof(Layers) + surface_textures * sizeof(TextureUse));

enum class Layer : std::uint8_t {
#define RAYNEST_MATERIAL_LAYER(extension, condition) extension,
#include "engine/shading/material_layers.def"
};

/// True if that layer adds something to what the surface is without.
[[nodiscard]] inline bool adds(Layer layer, const SurfaceRecord& s) {
    [[maybe_unused]] const Layers& l = s.layers;
    switch (layer) {
#define RAYNEST_MATERIAL_LAYER(extension, condition) \
    case Layer::extension:                           \
        return condition;
#include "engine/shading/material_layers.def"
    }
    return false;
}

/// True if one of the layers does.
[[nodiscard]] inline bool has_layers(const SurfaceRecord& surface) {
    return false
#define RAYNEST_MATERIAL_LAYER(extension, condition) || raynest::adds(Layer::extension, surface)
#include "engine/shading/material_layers.def"
        ;
}

/// True if tangents of vertices change how the surface looks.
[[nodiscard]] inline bool needs_tangents(const SurfaceRecord& surface) {
    return surface.has(TextureSlot::normal) || surface.has(TextureSlot::clearcoat_normal) ||
           surface.layers.anisotropy > 0;
}

/// Normals and tangents of a geometry's vertices, as byte offsets in `attributes`, or no_offset.
struct GeometryShading {
    std::uint64_t normals = no_offset;   ///< 3 x f32 per vertex, any length
    std::uint64_t tangents = no_offset;  ///< 4 x f32 per vertex; the fourth is the bitangent's sign
};

/// The smaller copies of a texture: level k has each side halved k times, rounded down, at least 1.
struct TextureLevels {
    std::uint64_t offset = no_offset;  ///< where level 1 begins; RGBA8 planes, one behind the other
    std::uint32_t count = 1;           ///< levels, level 0 included
    std::uint32_t linear = 0;          ///< 1: data; 0: colours in sRGB
};

/// Numbers that a light has for itself, at most.
inline constexpr std::size_t light_numbers_max = 4;

/// A light that the file places: KHR_lights_punctual, and lights of shading/lights.def by name.
struct LightRecord {
    std::uint32_t kind = 0;  ///< shading_type() of a name of shading/lights.def
    std::uint32_t name = 0;  ///< offset in `names`
    Vec3 position{0};
    Vec3 direction{0, 0, -1};        ///< unit vector, away from the light
    Vec3 intensity{0};               ///< colour x intensity: candela, or lux of a distant light
    float range = 0;                 ///< metres; 0: endless
    float own[light_numbers_max]{};  ///< what the kind's `numbers` name (light.h)
};
static_assert(sizeof(LightRecord) == 64);

/// Identifies a material or light by name; never 0. The engine's own names and those of a copy of
/// the tree share one space.
[[nodiscard]] constexpr std::uint32_t shading_type(const char* name) {
    return primitive_type(name);
}

/// The scene as shading sees it: the view of the kernels and the records above.
struct ShadingView {
    const SceneView* scene = nullptr;
    const SurfaceRecord* surfaces = nullptr;      ///< one per material
    const GeometryShading* geometries = nullptr;  ///< one per geometry
    const TextureLevels* levels = nullptr;        ///< one per texture
    const LightRecord* lights = nullptr;
    std::uint32_t light_count = 0;
    UpAxis up = UpAxis::y;
};

}  // namespace raynest
