#include "engine/shading/shading_point.h"

#include "engine/geometry/record_colours.h"
#include "engine/shading/types.h"

#include <algorithm>
#include <cmath>

namespace raynest {
namespace {

/// The corners of a hit triangle.
struct Corners {
    const std::uint32_t* index = nullptr;
    float u = 0, v = 0;

    Corners(const SceneView& scene, const GeometryRecord& geometry, std::uint32_t triangle,
            float b1, float b2)
        : index(scene.attribute<std::uint32_t>(geometry.indices) +
                std::size_t{3} * (triangle - geometry.first_triangle)),
          u(b1),
          v(b2) {}

    template <class T>
    [[nodiscard]] T mean(const T* values) const {
        return (1.0F - u - v) * values[index[0]] + u * values[index[1]] + v * values[index[2]];
    }
};

Vec2 transformed(const float (&m)[6], Vec2 st) {
    return {m[0] * st.x + m[1] * st.y + m[2], m[3] * st.x + m[4] * st.y + m[5]};
}

/// True if the use names a texture whose coordinates the geometry has.
bool is_used(const GeometryRecord& geometry, const TextureUse& use) {
    return use.texture != no_id && use.texcoord <= 1 &&
           geometry.texcoords[use.texcoord] != no_offset;
}

/// True if materials of a kind read Layers: `layered`, and what a copy of the tree adds.
constexpr bool reads_layers(std::uint32_t kind) {
    return kind != 0 && kind != shading_type("standard") && kind != shading_type("unlit");
}

/// The texture whose coordinates give the frame of normal textures and of anisotropy; null where
/// nothing needs a frame or the geometry has no coordinates.
const TextureUse* tangent_use(const GeometryRecord& geometry, const SurfaceRecord& surface) {
    const TextureUse& normal = surface.use(TextureSlot::normal);
    if (is_used(geometry, normal)) return &normal;
    if (!reads_layers(surface.kind)) return nullptr;
    const TextureUse& coat = surface.use(TextureSlot::clearcoat_normal);
    if (surface.layers.clearcoat > 0 && is_used(geometry, coat)) return &coat;
    const TextureUse& brushed = surface.use(TextureSlot::anisotropy);
    const bool has_coordinates =
        brushed.texcoord <= 1 && geometry.texcoords[brushed.texcoord] != no_offset;
    return surface.layers.anisotropy > 0 && has_coordinates ? &brushed : nullptr;
}

/// Where a hit lies in a texture.
struct TexturePlace {
    Vec2 st;
    Footprint footprint;
};

/// Finds the places of one hit in its textures. `width_share` is the squared width of the ray's
/// cone over twice the triangle's area, both in the world; 0: the finest level.
class TexturePlaces {
public:
    TexturePlaces(const SceneView& scene, const GeometryRecord& geometry, const Corners& corners,
                  float width_share)
        : scene_(scene),
          geometry_(geometry),
          corners_(corners),
          width_share_(width_share) {}

    [[nodiscard]] TexturePlace find(std::uint32_t set, const float (&m)[6]) const {
        const auto* st = scene_.attribute<Vec2>(geometry_.texcoords[set]);
        const Vec2 a = st[corners_.index[0]];
        const Vec2 e1 = st[corners_.index[1]] - a;
        const Vec2 e2 = st[corners_.index[2]] - a;
        const float scale = std::abs(m[0] * m[4] - m[1] * m[3]);
        const float share = std::abs(e1.x * e2.y - e1.y * e2.x) * scale * width_share_;
        TexturePlace place{transformed(m, corners_.mean(st)), {}};
        if (share > 0) place.footprint.log_width = 0.5F * rough_log2(share);
        return place;
    }

private:
    const SceneView& scene_;
    const GeometryRecord& geometry_;
    const Corners& corners_;
    float width_share_;
};

Vec3 vertex_colour(const SceneView& scene, const GeometryRecord& geometry, const Corners& corners) {
    if (geometry.colours == no_offset) return Vec3(1);
    const auto* rgba = scene.attribute<std::uint8_t>(geometry.colours);
    const std::array<float, 256>& linear = srgb_to_linear();
    Vec3 colour(0);
    for (int channel = 0; channel < 3; ++channel) {
        const auto at = [&](std::size_t corner) {
            return linear[rgba[std::size_t{4} * corners.index[corner] +
                               static_cast<std::size_t>(channel)]];
        };
        colour[channel] = interpolate(at(0), at(1), at(2), corners.u, corners.v);
    }
    return colour;
}

/// Sets the tangents that the normal texture's values refer to; leaves 0 where there are none.
void set_tangents(const ShadingView& view, const GeometryRecord& geometry,
                  const GeometryShading& shading, const TextureUse& use, const Corners& corners,
                  const Placement& placement, UnfinishedPoint& point) {
    const Vec3& n = point.n;
    Vec3 tangent(0);
    float sign = 1;
    if (shading.tangents != no_offset) {
        const Vec4 t = corners.mean(view.scene->attribute<Vec4>(shading.tangents));
        tangent = Vec3(placement.to_world * glm::dvec3(t));
        // The cross product below keeps its hand where a placement mirrors; the texture does not.
        sign = (t.w < 0) != placement.mirrors ? -1.0F : 1.0F;
    } else {
        // Without tangents: along the texture's first axis; the second one points up the picture.
        const auto* st = view.scene->attribute<Vec2>(geometry.texcoords[use.texcoord]);
        const auto* p = view.scene->attribute<Vec3>(geometry.positions);
        const float(&m)[6] = use.uv_transform;
        const Vec2 s0 = transformed(m, st[corners.index[0]]);
        const Vec2 d1 = transformed(m, st[corners.index[1]]) - s0;
        const Vec2 d2 = transformed(m, st[corners.index[2]]) - s0;
        const Vec3 e1 = p[corners.index[1]] - p[corners.index[0]];
        const Vec3 e2 = p[corners.index[2]] - p[corners.index[0]];
        const float det = d1.x * d2.y - d1.y * d2.x;
        if (det == 0) return;
        const glm::dvec3 along = glm::dvec3(d2.y * e1 - d1.y * e2) / static_cast<double>(det);
        const glm::dvec3 down = glm::dvec3(d1.x * e2 - d2.x * e1) / static_cast<double>(det);
        tangent = Vec3(placement.to_world * along);
        const Vec3 up = -Vec3(placement.to_world * down);
        sign = glm::dot(glm::cross(n, tangent), up) < 0 ? -1.0F : 1.0F;
    }
    tangent -= glm::dot(tangent, n) * n;
    const float length = glm::length(tangent);
    if (!(length > 0) || !std::isfinite(length)) return;
    point.tangent = tangent / length;
    point.bitangent = sign * glm::cross(n, point.tangent);
}

/// The way from a hit to the smooth surface: the mean of its distances to the planes at the
/// vertices, where it lies below them (Hanika, "Hacking the Shadow Terminator", Ray Tracing Gems
/// II, 2021). None where a normal is far from the triangle's: that is no smooth surface, but a leaf
/// that shades like its tree, or a box without edges.
Vec3 to_smooth(const Corners& corners, const Vec3* positions, const Vec3* normals,
               const Placement& placement, const ShadingPoint& point) {
    const Vec3 hit = corners.mean(positions);
    const std::array weights = {1.0F - corners.u - corners.v, corners.u, corners.v};
    Vec3 face = glm::cross(positions[corners.index[1]] - positions[corners.index[0]],
                           positions[corners.index[2]] - positions[corners.index[0]]);
    const glm::dvec3 outward = placement.normal(glm::dvec3(face));
    if (glm::dot(outward, glm::dvec3(point.normal)) < 0) face = -face;
    constexpr float least_cosine = 0.8F;
    Vec3 way(0);
    for (std::size_t i = 0; i < 3; ++i) {
        const Vec3& at = positions[corners.index[i]];
        const Vec3 n = point.front ? normals[corners.index[i]] : -normals[corners.index[i]];
        const float square = glm::dot(n, n);
        if (!(glm::dot(n, face) > least_cosine * std::sqrt(square * glm::dot(face, face))))
            return Vec3(0);
        // A smaller depth is rounding: the triangle is flat here.
        const float depth = -glm::dot(hit - at, n);
        if (depth * depth > 1e-8F * square * glm::dot(hit - at, hit - at))
            way += weights[i] * std::max(depth, 0.0F) / square * n;
    }
    const Vec3 world(placement.to_world * glm::dvec3(way));
    return glm::dot(world, point.normal) > 0 && std::isfinite(glm::dot(world, world)) ? world
                                                                                      : Vec3(0);
}

/// Turns a shading normal so far that the viewer sees its front: light would leak otherwise.
Vec3 turned_to(const Vec3& n, const Vec3& viewer) {
    constexpr float least = 0.02F;
    const float seen = glm::dot(n, viewer);
    if (seen >= least) return n;
    return glm::normalize(n + (least - seen) * viewer);
}

/// Bends a shading normal towards the geometric one until the mirrored viewer leaves the surface:
/// bumps that lean away from a grazing view would be black otherwise. As Cycles does
/// (ensure_valid_specular_reflection). Both normals are on the viewer's side.
Vec3 bent_to_reflect(const Vec3& n, const Vec3& viewer, const Vec3& geometric) {
    const float viewer_z = glm::dot(viewer, geometric);
    const float n_z = glm::dot(n, geometric);
    const float least = std::min(0.9F * viewer_z, 0.01F);
    if (2.0F * glm::dot(n, viewer) * n_z - viewer_z >= least) return n;
    const Vec3 aside = n - n_z * geometric;
    const float length = glm::length(aside);
    if (!(length > 0)) return n;
    // With z along the geometric normal and n in the plane of x and z, the mirrored viewer's z is
    // 2 (n_x v_x + n_z v_z) n_z - v_z. Setting it to `least` is a quadratic in n_z squared.
    const Vec3 x = aside / length;
    const float viewer_x = glm::dot(viewer, x);
    const float a = viewer_x * viewer_x + viewer_z * viewer_z;
    const float b = a + viewer_z * least;
    const float c = least + viewer_z;
    const float root = std::sqrt(std::max(b * b - a * c * c, 0.0F));
    const float square = std::clamp((viewer_x < 0 ? b + root : b - root) / (2.0F * a), 0.0F, 1.0F);
    return std::sqrt(1.0F - square) * x + std::sqrt(square) * geometric;
}

float clamped(float x) {
    return x > 0 ? std::min(x, 1.0F) : 0.0F;
}

bool has_normal(const UnfinishedPoint& from, TextureSlot slot) {
    return from.texel(slot) != nullptr && from.tangent != Vec3(0);
}

/// The shading normal on the viewer's side: that of a normal texture, or else of the vertices.
Vec3 normal_of(const UnfinishedPoint& from, TextureSlot slot, float scale) {
    Vec3 n = from.n;
    const bool has_bumps = has_normal(from, slot);
    if (has_bumps) {
        const Vec4& texel = *from.texel(slot);
        n = glm::normalize((2.0F * texel.x - 1.0F) * scale * from.tangent +
                           (2.0F * texel.y - 1.0F) * scale * from.bitangent +
                           std::max(2.0F * texel.z - 1.0F, 1e-3F) * n);
    }
    if (!from.point.front) n = -n;
    n = turned_to(n, from.viewer);
    return has_bumps ? bent_to_reflect(n, from.viewer, from.point.normal) : n;
}

/// The textures of the layers that matter.
template <class LookUp>
void begin_layers(const LookUp& look_up_if, const SurfaceRecord& surface) {
#define RAYNEST_MATERIAL_LAYER_MAP(extension, word, slot) \
    look_up_if(adds(Layer::extension, surface), TextureSlot::slot);
#include "engine/shading/material_layers.def"
}

/// Multiplies the factors of Layers by their textures.
void finish_layers(UnfinishedPoint& from) {
    MaterialPoint& material = from.point.material;
    Layers& layers = material.layers;
#define RAYNEST_MATERIAL_LAYER_TEXTURE(extension, word, slot, factor, channel) \
    if (const Vec4* t = from.texel(TextureSlot::slot)) layers.factor *= texel::channel(*t);
#include "engine/shading/material_layers.def"
    material.film_thickness = layers.thickness_most;
    if (const Vec4* texel = from.texel(TextureSlot::iridescence_thickness))
        material.film_thickness =
            layers.thickness_least + texel->y * (layers.thickness_most - layers.thickness_least);
}

/// The coat's normal and the direction of anisotropy. After the point's frame is known.
void finish_directions(UnfinishedPoint& from) {
    ShadingPoint& point = from.point;
    Layers& layers = point.material.layers;
    if (layers.clearcoat > 0)
        point.material.coat_normal = point.frame.to_local(
            normal_of(from, TextureSlot::clearcoat_normal, layers.clearcoat_normal_scale));
    if (layers.anisotropy <= 0) return;
    Vec2 along(1, 0);
    if (const Vec4* texel = from.texel(TextureSlot::anisotropy))
        along = 2.0F * Vec2(texel->x, texel->y) - 1.0F;
    const float cosine = std::cos(layers.anisotropy_turn);
    const float sine = std::sin(layers.anisotropy_turn);
    along = {along.x * cosine - along.y * sine, along.x * sine + along.y * cosine};
    const Vec3 local = point.frame.to_local(along.x * from.tangent + along.y * from.bitangent);
    const float length = std::sqrt(local.x * local.x + local.y * local.y);
    // Without coordinates no direction is known.
    if (length > 1e-6F)
        point.material.along = Vec2(local) / length;
    else
        layers.anisotropy = 0;
}

}  // namespace

void fetch_corners(const SceneView& scene, const HitRecord& hit) {
    const ObjectRecord& object = scene.objects[hit.object];
    if (object.triangle_count == 0) return;
    const GeometryRecord& geometry = scene.geometry_of(object, hit.triangle);
    __builtin_prefetch(scene.attribute<std::uint32_t>(geometry.indices) +
                       std::size_t{3} * (hit.triangle - geometry.first_triangle));
}

void fetch_vertices(const ShadingView& view, const HitRecord& hit) {
    const SceneView& scene = *view.scene;
    const ObjectRecord& object = scene.objects[hit.object];
    if (object.triangle_count == 0) return;
    const GeometryRecord& geometry = scene.geometry_of(object, hit.triangle);
    const Corners corners(scene, geometry, hit.triangle, 0, 0);
    const std::uint64_t normals = view.geometries == nullptr
                                      ? no_offset
                                      : view.geometries[&geometry - scene.geometries].normals;
    for (std::size_t i = 0; i < 3; ++i) {
        const std::uint32_t vertex = corners.index[i];
        __builtin_prefetch(scene.attribute<Vec3>(geometry.positions) + vertex);
        if (normals != no_offset) __builtin_prefetch(scene.attribute<Vec3>(normals) + vertex);
        if (geometry.texcoords[0] != no_offset)
            __builtin_prefetch(scene.attribute<Vec2>(geometry.texcoords[0]) + vertex);
    }
}

void begin_point(const ShadingView& view, const Ray& ray, const HitRecord& hit, const Vec3& normal,
                 double twice_area, float width, const Placement& placement, TextureBatch& batch,
                 UnfinishedPoint& out) {
    const SceneView& scene = *view.scene;
    const ObjectRecord& object = scene.objects[hit.object];
    out.viewer = -glm::normalize(ray.direction);
    out.looked_up = 0;
    out.tint = Vec3(1);
    out.tangent = Vec3(0);
    ShadingPoint& point = out.point;
    point = {};
    point.front = glm::dot(normal, out.viewer) >= 0;
    point.normal = point.front ? normal : -normal;
    point.kind = default_material();
    if (normal == Vec3(0)) point.normal = out.viewer;
    out.n = point.front ? point.normal : -point.normal;
    if (object.triangle_count == 0) {
        if (const std::uint8_t* const rgba = record_colours(scene, object); rgba != nullptr) {
            const std::uint8_t* const own = rgba + std::size_t{4} * hit.triangle;
            const auto& linear = srgb_to_linear();
            out.tint = {linear[own[0]], linear[own[1]], linear[own[2]]};
        }
        return;
    }

    const GeometryRecord& geometry = scene.geometry_of(object, hit.triangle);
    const Corners corners(scene, geometry, hit.triangle, hit.u, hit.v);
    const float cosine = std::max(std::abs(glm::dot(point.normal, out.viewer)), 0.05F);
    const float across = width / cosine;
    const auto area = static_cast<float>(twice_area);
    const TexturePlaces places(scene, geometry, corners, area > 0 ? across * across / area : 0.0F);
    const auto look_up = [&](TextureSlot slot, std::uint32_t texture, std::uint32_t set,
                             const float(&m)[6]) {
        TexturePlace place = places.find(set, m);
        // The mean of bumps is flat, and reflects more than they do: the samples of a pixel average
        // that.
        if (slot == TextureSlot::normal) place.footprint = {};
        const auto k = static_cast<std::size_t>(slot);
        out.looked_up |= 1U << k;
        batch.add(texture, place.st, place.footprint, !has_colours(slot), &out.texels[k]);
    };

    MaterialPoint& material = point.material;
    if (geometry.material != no_id) {
        const MaterialRecord& record = scene.materials[geometry.material];
        material.base_colour = Vec3(record.base_colour);
        if (has_texture(geometry, record))
            look_up(TextureSlot::base, record.texture, record.texcoord, record.uv_transform);
        if (view.surfaces != nullptr) point.surface = &view.surfaces[geometry.material];
    }
    if (geometry.colours != no_offset) out.tint = vertex_colour(scene, geometry, corners);

    const GeometryShading shading = view.geometries == nullptr
                                        ? GeometryShading{}
                                        : view.geometries[&geometry - scene.geometries];
    if (shading.normals != no_offset) {
        const Vec3 mean = corners.mean(scene.attribute<Vec3>(shading.normals));
        const glm::dvec3 world = placement.normal(glm::dvec3(mean));
        const double length = glm::length(world);
        if (length > 0 && std::isfinite(length)) out.n = Vec3(world / length);
        point.smooth = point.front ? out.n : -out.n;
        point.to_smooth = to_smooth(corners, scene.attribute<Vec3>(geometry.positions),
                                    scene.attribute<Vec3>(shading.normals), placement, point);
    }
    if (point.surface == nullptr) return;
    const SurfaceRecord& surface = *point.surface;
    point.kind = surface.kind;
    material.metallic = surface.metallic;
    material.roughness = surface.roughness;
    material.emission = surface.emission;
    material.ior = surface.ior;
    material.transmission = surface.transmission;
    material.solid = surface.thickness > 0;
    material.inside = material.solid && !point.front;
    const auto look_up_if = [&](bool matters, TextureSlot slot) {
        const TextureUse& use = surface.use(slot);
        if (matters && is_used(geometry, use))
            look_up(slot, use.texture, use.texcoord, use.uv_transform);
    };
    look_up_if(true, TextureSlot::metallic_roughness);
    look_up_if(!is_black(material.emission), TextureSlot::emission);
    look_up_if(material.transmission > 0, TextureSlot::transmission);
    look_up_if(true, TextureSlot::normal);
    if (reads_layers(point.kind)) {
        material.layers = surface.layers;
        begin_layers(look_up_if, surface);
    }
    if (const TextureUse* use = tangent_use(geometry, surface))
        set_tangents(view, geometry, shading, *use, corners, placement, out);
}

const ShadingPoint& finish_point(UnfinishedPoint& from) {
    ShadingPoint& point = from.point;
    MaterialPoint& material = point.material;
    if (const Vec4* texel = from.texel(TextureSlot::base)) material.base_colour *= Vec3(*texel);
    material.base_colour *= from.tint;
    for (int c = 0; c < 3; ++c) material.base_colour[c] = clamped(material.base_colour[c]);
    if (reads_layers(point.kind)) finish_layers(from);
    if (const Vec4* texel = from.texel(TextureSlot::metallic_roughness)) {
        material.roughness *= texel->y;
        material.metallic *= texel->z;
    }
    if (const Vec4* texel = from.texel(TextureSlot::emission)) material.emission *= Vec3(*texel);
    if (const Vec4* texel = from.texel(TextureSlot::transmission))
        material.transmission *= texel->x;
    const float scale = point.surface != nullptr ? point.surface->normal_scale : 1.0F;
    const bool has_bumps = has_normal(from, TextureSlot::normal);
    point.frame = basis_around(normal_of(from, TextureSlot::normal, scale));
    if (has_bumps) material.smooth = point.frame.to_local(point.front ? from.n : -from.n);
    if (reads_layers(point.kind)) finish_directions(from);
    return point;
}

Vec3 triangle_emission(const ShadingView& view, const ObjectRecord& object, std::uint32_t triangle,
                       float u, float v) {
    const SceneView& scene = *view.scene;
    const GeometryRecord& geometry = scene.geometry_of(object, triangle);
    if (view.surfaces == nullptr || geometry.material == no_id) return Vec3(0);
    const SurfaceRecord& surface = view.surfaces[geometry.material];
    const TextureUse& use = surface.use(TextureSlot::emission);
    if (!is_used(geometry, use)) return surface.emission;
    const Corners corners(scene, geometry, triangle, u, v);
    const TexturePlace place =
        TexturePlaces(scene, geometry, corners, 0).find(use.texcoord, use.uv_transform);
    return surface.emission *
           Vec3(sample_texture(view, use.texture, place.st, place.footprint, false));
}

}  // namespace raynest
