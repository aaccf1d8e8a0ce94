#include "engine/queries/base_colour.h"

#include "engine/geometry/record_colours.h"
#include "engine/intersectors/texture.h"

#include <array>
#include <cmath>
#include <cstddef>

namespace raynest {
namespace {

float decode_srgb(float s) {
    return s <= 0.04045F ? s / 12.92F : std::pow((s + 0.055F) / 1.055F, 2.4F);
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

}  // namespace

Vec3 base_colour(const SceneView& scene, const HitRecord& hit) {
    const ObjectRecord& object = scene.objects[hit.object];
    if (object.triangle_count == 0) {
        const std::uint8_t* const rgba = record_colours(scene, object);
        if (rgba == nullptr) return Vec3(1);
        const std::uint8_t* const own = rgba + std::size_t{4} * hit.triangle;
        const auto& linear = srgb_table();
        return {linear[own[0]], linear[own[1]], linear[own[2]]};
    }
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
                return linear[rgba[std::size_t{4} * corner[i] + static_cast<std::size_t>(channel)]];
            };
            colour[channel] *= interpolate(vertex(0), vertex(1), vertex(2), hit.u, hit.v);
        }
    }
    return colour;
}

}  // namespace raynest
