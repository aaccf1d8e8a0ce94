#include "engine/shading/shading_point.h"

#include "engine/shading/types.h"

#include <algorithm>
#include <cmath>

namespace raynest {
namespace {

/// The corners of a hit triangle.
struct Corners {
    const std::uint32_t* index = nullptr;
    float u = 0, v = 0;

    Corners(const SceneView& scene, const GeometryRecord& geometry, std::uint32_t triangle, float b1,
            float b2)
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
    return use.texture != no_id && use.texcoord <= 1 && geometry.texcoords[use.texcoord] != no_offset;
}

/// Looks textures of one hit up.
class Lookup {
public:
    Lookup(const ShadingView& view, const GeometryRecord& geometry, const Corners& corners,
           float log_width, double world_area)
        : view_(view),
          geometry_(geometry),
          corners_(corners),
          log_width_(log_width),
          world_area_(world_area) {}

    [[nodiscard]] Vec4 value(std::uint32_t texture, std::uint32_t set, const float (&m)[6],
                             bool data) const {
        const auto* st = view_.scene->attribute<Vec2>(geometry_.texcoords[set]);
        const Vec2 a = st[corners_.index[0]];
        const Vec2 e1 = st[corners_.index[1]] - a;
        const Vec2 e2 = st[corners_.index[2]] - a;
        const float scale = std::abs(m[0] * m[4] - m[1] * m[3]);
        const double area =
            static_cast<double>(std::abs(e1.x * e2.y - e1.y * e2.x) * scale);
        Footprint footprint;
        if (area > 0 && world_area_ > 0)
            footprint.log_width =
                log_width_ + static_cast<float>(0.5 * std::log2(area / world_area_));
        return sample_texture(view_, texture, transformed(m, corners_.mean(st)), footprint, data);
    }
    [[nodiscard]] Vec4 value(const TextureUse& use, bool data) const {
        return value(use.texture, use.texcoord, use.uv_transform, data);
    }
    [[nodiscard]] const Corners& corners() const { return corners_; }

private:
    const ShadingView& view_;
    const GeometryRecord& geometry_;
    const Corners& corners_;
    float log_width_;
    double world_area_;
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

/// The normal that a normal texture gives, in the world; `n` is the vertices' normal there.
Vec3 mapped_normal(const ShadingView& view, const GeometryRecord& geometry,
                   const GeometryShading& shading, const SurfaceRecord& surface,
                   const Lookup& lookup, const Placement& placement, const Vec3& n) {
    const Vec4 texel = lookup.value(surface.normal, true);
    const Vec3 local((2.0F * texel.x - 1.0F) * surface.normal_scale,
                     (2.0F * texel.y - 1.0F) * surface.normal_scale,
                     std::max(2.0F * texel.z - 1.0F, 1e-3F));
    const Corners& corners = lookup.corners();
    Vec3 tangent(0);
    float sign = 1;
    if (shading.tangents != no_offset) {
        const Vec4 t = corners.mean(view.scene->attribute<Vec4>(shading.tangents));
        tangent = Vec3(placement.to_world * glm::dvec3(t));
        // The cross product below keeps its hand where a placement mirrors; the texture does not.
        const bool mirrors = glm::determinant(placement.to_world) < 0;
        sign = (t.w < 0) != mirrors ? -1.0F : 1.0F;
    } else {
        // Without tangents: along the texture's first axis; the second one points up the picture.
        const auto* st = view.scene->attribute<Vec2>(geometry.texcoords[surface.normal.texcoord]);
        const auto* p = view.scene->attribute<Vec3>(geometry.positions);
        const float(&m)[6] = surface.normal.uv_transform;
        const Vec2 s0 = transformed(m, st[corners.index[0]]);
        const Vec2 d1 = transformed(m, st[corners.index[1]]) - s0;
        const Vec2 d2 = transformed(m, st[corners.index[2]]) - s0;
        const Vec3 e1 = p[corners.index[1]] - p[corners.index[0]];
        const Vec3 e2 = p[corners.index[2]] - p[corners.index[0]];
        const float det = d1.x * d2.y - d1.y * d2.x;
        if (det == 0) return n;
        const glm::dvec3 along = glm::dvec3(d2.y * e1 - d1.y * e2) / static_cast<double>(det);
        const glm::dvec3 down = glm::dvec3(d1.x * e2 - d2.x * e1) / static_cast<double>(det);
        tangent = Vec3(placement.to_world * along);
        const Vec3 up = -Vec3(placement.to_world * down);
        sign = glm::dot(glm::cross(n, tangent), up) < 0 ? -1.0F : 1.0F;
    }
    tangent -= glm::dot(tangent, n) * n;
    const float length = glm::length(tangent);
    if (!(length > 0) || !std::isfinite(length)) return n;
    tangent /= length;
    const Vec3 bitangent = sign * glm::cross(n, tangent);
    return glm::normalize(local.x * tangent + local.y * bitangent + local.z * n);
}

/// Turns a shading normal so far that the viewer sees its front: light would leak otherwise.
Vec3 turned_to(const Vec3& n, const Vec3& viewer) {
    constexpr float least = 0.02F;
    const float seen = glm::dot(n, viewer);
    if (seen >= least) return n;
    return glm::normalize(n + (least - seen) * viewer);
}

float clamped(float x) {
    return x > 0 ? std::min(x, 1.0F) : 0.0F;
}

}  // namespace

ShadingPoint shading_point(const ShadingView& view, const Ray& ray, const HitRecord& hit,
                           const Vec3& normal, float width, const Placement& placement) {
    const SceneView& scene = *view.scene;
    const ObjectRecord& object = scene.objects[hit.object];
    const Vec3 viewer = -glm::normalize(ray.direction);
    ShadingPoint point;
    point.front = glm::dot(normal, viewer) >= 0;
    point.normal = point.front ? normal : -normal;
    point.kind = default_material();
    if (normal == Vec3(0)) point.normal = viewer;
    if (object.triangle_count == 0) {
        point.frame = frame_around(point.normal);
        return point;
    }

    const GeometryRecord& geometry = scene.geometry_of(object, hit.triangle);
    const Corners corners(scene, geometry, hit.triangle, hit.u, hit.v);
    const auto* positions = scene.attribute<Vec3>(geometry.positions);
    const glm::dvec3 p0(positions[corners.index[0]]);
    const glm::dvec3 e1 = placement.to_world * (glm::dvec3(positions[corners.index[1]]) - p0);
    const glm::dvec3 e2 = placement.to_world * (glm::dvec3(positions[corners.index[2]]) - p0);
    const float cosine = std::max(std::abs(glm::dot(point.normal, viewer)), 0.05F);
    const Lookup lookup(view, geometry, corners, std::log2(std::max(width, 1e-30F) / cosine),
                        glm::length(glm::cross(e1, e2)));

    MaterialPoint& material = point.material;
    const MaterialRecord* record = nullptr;
    if (geometry.material != no_id) {
        record = &scene.materials[geometry.material];
        material.base_colour = Vec3(record->base_colour);
        if (has_texture(geometry, *record))
            material.base_colour *=
                Vec3(lookup.value(record->texture, record->texcoord, record->uv_transform, false));
        if (view.surfaces != nullptr) point.surface = &view.surfaces[geometry.material];
    }
    material.base_colour *= vertex_colour(scene, geometry, corners);
    for (int c = 0; c < 3; ++c) material.base_colour[c] = clamped(material.base_colour[c]);

    Vec3 n = point.front ? point.normal : -point.normal;
    const GeometryShading shading =
        view.geometries == nullptr ? GeometryShading{}
                                   : view.geometries[&geometry - scene.geometries];
    if (shading.normals != no_offset) {
        const Vec3 mean = corners.mean(scene.attribute<Vec3>(shading.normals));
        const glm::dvec3 world = placement.normal(glm::dvec3(mean));
        const double length = glm::length(world);
        if (length > 0 && std::isfinite(length)) n = Vec3(world / length);
    }
    if (point.surface != nullptr) {
        const SurfaceRecord& surface = *point.surface;
        point.kind = surface.kind;
        material.metallic = surface.metallic;
        material.roughness = surface.roughness;
        material.emission = surface.emission;
        material.ior = surface.ior;
        material.transmission = surface.transmission;
        material.solid = surface.thickness > 0;
        material.inside = material.solid && !point.front;
        if (is_used(geometry, surface.metallic_roughness)) {
            const Vec4 texel = lookup.value(surface.metallic_roughness, true);
            material.roughness *= texel.y;
            material.metallic *= texel.z;
        }
        if (is_used(geometry, surface.emission_texture) && !is_black(material.emission))
            material.emission *= Vec3(lookup.value(surface.emission_texture, false));
        if (is_used(geometry, surface.transmission_texture) && material.transmission > 0)
            material.transmission *= lookup.value(surface.transmission_texture, true).x;
        if (is_used(geometry, surface.occlusion)) {
            const float open = lookup.value(surface.occlusion, true).x;
            point.occlusion = 1.0F + surface.occlusion_strength * (open - 1.0F);
        }
        if (is_used(geometry, surface.normal))
            n = mapped_normal(view, geometry, shading, surface, lookup, placement, n);
    }
    if (!point.front) n = -n;
    point.frame = frame_around(turned_to(n, viewer));
    return point;
}

Vec3 triangle_emission(const ShadingView& view, const ObjectRecord& object, std::uint32_t triangle,
                       float u, float v) {
    const SceneView& scene = *view.scene;
    const GeometryRecord& geometry = scene.geometry_of(object, triangle);
    if (view.surfaces == nullptr || geometry.material == no_id) return Vec3(0);
    const SurfaceRecord& surface = view.surfaces[geometry.material];
    if (!is_used(geometry, surface.emission_texture)) return surface.emission;
    const Corners corners(scene, geometry, triangle, u, v);
    const Lookup lookup(view, geometry, corners, -1e9F, 1);
    return surface.emission * Vec3(lookup.value(surface.emission_texture, false));
}

}  // namespace raynest
