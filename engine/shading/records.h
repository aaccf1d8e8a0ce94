// Data that shading reads beside the views of the kernels: records in the arena, each with the
// index of the material, geometry or texture that it belongs to. Kernels never read them.
#pragma once

#include "engine/geometry/up_axis.h"
#include "engine/geometry/views.h"
#include "engine/math/vec.h"

#include <cstddef>
#include <cstdint>

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
    clearcoat,
    clearcoat_roughness,
    clearcoat_normal,
    sheen,
    sheen_roughness,
    specular,
    specular_colour,
    iridescence,
    iridescence_thickness,
    anisotropy,
    base,
};
inline constexpr auto surface_textures = static_cast<std::size_t>(TextureSlot::base);

/// True if a texture holds colours, in sRGB; others hold data.
[[nodiscard]] constexpr bool has_colours(TextureSlot slot) {
    return slot == TextureSlot::base || slot == TextureSlot::emission ||
           slot == TextureSlot::sheen || slot == TextureSlot::specular_colour;
}

/// Factors of KHR_materials_ clearcoat, sheen, specular, iridescence and anisotropy. The defaults
/// add nothing.
struct Layers {
    float clearcoat = 0;
    float clearcoat_roughness = 0;
    float clearcoat_normal_scale = 1;
    Vec3 sheen{0};
    float sheen_roughness = 0;
    float specular = 1;
    Vec3 specular_colour{1};
    float iridescence = 0;
    float iridescence_ior = 1.3F;
    float thickness_least = 100, thickness_most = 400;  ///< the iridescent film's, in nanometres
    float anisotropy = 0;
    float anisotropy_turn = 0;  ///< radians, from the tangent towards the bitangent

    [[nodiscard]] bool add_something() const {
        return clearcoat > 0 || sheen != Vec3(0) || specular != 1 || specular_colour != Vec3(1) ||
               iridescence > 0 || anisotropy > 0;
    }
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
    Layers layers;  ///< for the kind `layered`
    TextureUse textures[surface_textures];

    [[nodiscard]] TextureUse& use(TextureSlot slot) {
        return textures[static_cast<std::size_t>(slot)];
    }
    [[nodiscard]] const TextureUse& use(TextureSlot slot) const {
        return textures[static_cast<std::size_t>(slot)];
    }
};
static_assert(sizeof(SurfaceRecord) == 612);

/// True if tangents of vertices change how the surface looks.
[[nodiscard]] inline bool needs_tangents(const SurfaceRecord& surface) {
    return surface.use(TextureSlot::normal).texture != no_id ||
           surface.use(TextureSlot::clearcoat_normal).texture != no_id ||
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

/// A light that the file places: KHR_lights_punctual, and lights of shading/lights.def by name.
struct LightRecord {
    std::uint32_t kind = 0;  ///< shading_type() of a name of shading/lights.def
    std::uint32_t name = 0;  ///< offset in `names`
    Vec3 position{0};
    Vec3 direction{0, 0, -1};  ///< unit vector, away from the light
    Vec3 intensity{0};         ///< colour x intensity: candela, or lux of a distant light
    float range = 0;           ///< metres; 0: endless
    float inner_cosine = 1;    ///< full light within the inner cone, none outside the outer one
    float outer_cosine = 0;
};
static_assert(sizeof(LightRecord) == 56);

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
