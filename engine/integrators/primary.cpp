// `--integrator primary`: base colour x |n.v|, a picture that shows the surfaces that rays hit, and
// nothing else.
#include "engine/integrators/picture.h"
#include "engine/intersectors/texture.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

namespace raynest {
namespace {

const Vec4 background(0.18F, 0.18F, 0.18F, 0.0F);

float decode_srgb(float s) {
    return s <= 0.04045F ? s / 12.92F : std::pow((s + 0.055F) / 1.055F, 2.4F);
}

float encode_srgb(float linear) {
    return linear <= 0.0031308F ? linear * 12.92F : 1.055F * std::pow(linear, 1 / 2.4F) - 0.055F;
}

/// sRGB bytes -> linear.
const std::array<float, 256>& srgb_table() {
    static const std::array<float, 256> table = [] {
        std::array<float, 256> t{};
        for (std::size_t i = 0; i < t.size(); ++i)
            t[i] = decode_srgb(static_cast<float>(i) / 255.0F);
        return t;
    }();
    return table;
}

/// Linear colour of a texture at (s, t), filtered like its alpha (engine/intersectors/texture.h).
Vec3 sample_colour(const SceneView& scene, const TextureRecord& texture, Vec2 st) {
    const auto* plane = scene.attribute<std::uint8_t>(texture.colour);
    const float x = wrap_coordinate(st.x, texture.wrap_s) * static_cast<float>(texture.width);
    const float y = wrap_coordinate(st.y, texture.wrap_t) * static_cast<float>(texture.height);
    const auto texel = [&](int column, int row) {
        const std::size_t at =
            4 * (std::size_t{wrap_texel(row, texture.height, texture.wrap_t)} * texture.width +
                 wrap_texel(column, texture.width, texture.wrap_s));
        const auto& linear = srgb_table();
        return Vec3(linear[plane[at]], linear[plane[at + 1]], linear[plane[at + 2]]);
    };
    if (texture.nearest != 0) return texel(static_cast<int>(x), static_cast<int>(y));
    const float left = std::floor(x - 0.5F);
    const float top = std::floor(y - 0.5F);
    const int column = static_cast<int>(left);
    const int row = static_cast<int>(top);
    const float across = x - 0.5F - left;
    const float down = y - 0.5F - top;
    return glm::mix(glm::mix(texel(column, row), texel(column + 1, row), across),
                    glm::mix(texel(column, row + 1), texel(column + 1, row + 1), across), down);
}

/// Returns baseColorFactor x baseColorTexture x COLOR_0; white by default.
Vec3 base_colour(const SceneView& scene, const HitRecord& hit) {
    const ObjectRecord& object = scene.objects[hit.object];
    if (object.triangle_count == 0) return Vec3(1);
    const GeometryRecord& geometry = scene.geometry_of(object, hit.triangle);
    Vec3 colour(1);
    if (geometry.material != no_id) {
        const MaterialRecord& material = scene.materials[geometry.material];
        colour = Vec3(material.base_colour);
        if (has_texture(geometry, material)) {
            const Vec2 st =
                texture_coordinates(scene, geometry, material.texcoord, hit.triangle, hit.u, hit.v);
            const float* m = material.uv_transform;
            colour *=
                sample_colour(scene, scene.textures[material.texture],
                              {m[0] * st.x + m[1] * st.y + m[2], m[3] * st.x + m[4] * st.y + m[5]});
        }
    }
    if (geometry.colours != no_offset) {
        const auto* corner = scene.attribute<std::uint32_t>(geometry.indices) +
                             std::size_t{3} * (hit.triangle - geometry.first_triangle);
        const auto* rgba = scene.attribute<std::uint8_t>(geometry.colours);
        const auto& linear = srgb_table();
        for (int channel = 0; channel < 3; ++channel) {
            const auto vertex = [&](std::size_t i) {
                return linear[rgba[std::size_t{4} * corner[i] +
                                   static_cast<std::size_t>(channel)]];
            };
            colour[channel] *= interpolate(vertex(0), vertex(1), vertex(2), hit.u, hit.v);
        }
    }
    return colour;
}

/// Returns |n.v| of unit vectors; 1 if the primitive has no normal.
float facing(const Vec3& normal, const Ray& ray) {
    if (normal == Vec3(0)) return 1;
    const glm::dvec3 direction = glm::normalize(glm::dvec3(ray.direction));
    return static_cast<float>(std::abs(glm::dot(glm::dvec3(normal), direction)));
}

}  // namespace

void shade_primary(const ColumnSource& source, std::span<Vec4> out) {
    for (std::size_t i = 0; i < out.size(); ++i) {
        const HitRecord& hit = source.hits[i];
        const Ray& ray = source.rays[i];
        out[i] = hit.hit == 0 ? background
                              : Vec4(base_colour(*source.scene, hit) *
                                         facing(world_normal(source, ray, hit), ray),
                                     1.0F);
    }
}

std::optional<CameraHits> render_primary(const PixelRange& pixels, const ColumnSource& scene,
                                         RayCaster& caster, const PixelArrays& arrays,
                                         std::span<Vec4> out) {
    const std::span<Ray> rays = arrays.rays.first(pixels.rays());
    const std::span<HitRecord> hits = arrays.hits.first(rays.size());
    generate_samples(pixels.camera, pixels.samples, pixels.first, rays, pixels.window);
    const auto* pinhole = std::get_if<Pinhole>(&pixels.camera);
    const bool cast = pinhole != nullptr && pixels.samples == 1 && pixels.window.is_whole()
                          ? caster.closest(PinholeRays{*pinhole, pixels.first, true}, rays, hits)
                          : caster.closest(rays, hits);
    if (!cast) return std::nullopt;

    ColumnSource source = scene;
    source.rays = rays;
    source.hits = hits;
    if (pixels.samples == 1) {
        shade_primary(source, out);
        return count_hits(hits);
    }
    std::vector<Vec4> colours(pixels.samples);
    for (std::size_t i = 0; i < pixels.count; ++i) {
        source.rays = rays.subspan(i * pixels.samples, pixels.samples);
        source.hits = hits.subspan(i * pixels.samples, pixels.samples);
        shade_primary(source, colours);
        Vec4 sum(0);
        for (const Vec4& colour : colours) sum += colour;
        out[i] = sum / static_cast<float>(pixels.samples);
    }
    return count_hits(hits);
}

CameraHits count_hits(std::span<const HitRecord> hits) {
    CameraHits counts;
    counts.rays = hits.size();
    for (const HitRecord& hit : hits) {
        counts.hits += hit.hit;
        counts.backs += hit.hit != 0 && hit.front == 0 ? 1U : 0U;
    }
    return counts;
}

Picture to_picture(std::uint32_t width, std::uint32_t height, std::span<const Vec4> pixels) {
    // NaN and negative numbers become 0.
    const auto to_byte = [](float x) {
        return static_cast<std::uint8_t>(x > 0 ? std::min(x, 1.0F) * 255.0F + 0.5F : 0.0F);
    };
    Picture picture{width, height, {}};
    picture.rgba.reserve(pixels.size() * 4);
    for (const Vec4& p : pixels) {
        for (int channel = 0; channel < 3; ++channel) {
            picture.rgba.push_back(to_byte(encode_srgb(p[channel])));
        }
        picture.rgba.push_back(to_byte(p.w));
    }
    return picture;
}

}  // namespace raynest
