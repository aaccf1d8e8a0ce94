// Colours and data of textures: trilinear between the two copies that fit the size of a ray's cone.
#pragma once

#include "engine/intersectors/texture.h"
#include "engine/shading/records.h"

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

namespace raynest {

/// Returns the linear values of the 256 bytes of sRGB.
[[nodiscard]] const std::array<float, 256>& srgb_to_linear();

/// How large a ray's cone is on a triangle: log2 of its width, in units in which the triangle's
/// texture coordinates have area 1. A texture adds half of log2 of its texels per such unit.
struct Footprint {
    float log_width = -1e9F;  ///< far below 0: the finest level
};

/// One level of a texture.
struct TexturePlane {
    const std::uint8_t* rgba;
    std::uint32_t width, height;
};

[[nodiscard]] inline TexturePlane texture_plane(const ShadingView& view, std::uint32_t texture,
                                                std::uint32_t level) {
    const TextureRecord& record = view.scene->textures[texture];
    TexturePlane plane{view.scene->attribute<std::uint8_t>(record.colour), record.width,
                       record.height};
    if (level == 0 || view.levels == nullptr) return plane;
    plane.rgba = view.scene->attribute<std::uint8_t>(view.levels[texture].offset);
    for (std::uint32_t k = 1;; ++k) {
        plane.width = std::max(plane.width / 2, 1U);
        plane.height = std::max(plane.height / 2, 1U);
        if (k == level) return plane;
        plane.rgba += std::size_t{4} * plane.width * plane.height;
    }
}

/// Bilinear, in linear values; `decode` maps a byte of a colour channel.
template <class Decode>
[[nodiscard]] Vec4 sample_plane(const TexturePlane& plane, const TextureRecord& record, Vec2 st,
                                Decode&& decode) {
    const float x = wrap_coordinate(st.x, record.wrap_s) * static_cast<float>(plane.width);
    const float y = wrap_coordinate(st.y, record.wrap_t) * static_cast<float>(plane.height);
    const auto texel = [&](int column, int row) {
        const std::size_t at =
            std::size_t{4} *
            (std::size_t{wrap_texel(row, plane.height, record.wrap_t)} * plane.width +
             wrap_texel(column, plane.width, record.wrap_s));
        const std::uint8_t* p = plane.rgba + at;
        return Vec4(decode(p[0]), decode(p[1]), decode(p[2]), static_cast<float>(p[3]) / 255.0F);
    };
    if (record.nearest != 0) return texel(static_cast<int>(x), static_cast<int>(y));
    const float left = std::floor(x - 0.5F);
    const float top = std::floor(y - 0.5F);
    const int column = static_cast<int>(left);
    const int row = static_cast<int>(top);
    const float across = x - 0.5F - left;
    const float down = y - 0.5F - top;
    const Vec4 upper = texel(column, row) * (1 - across) + texel(column + 1, row) * across;
    const Vec4 lower = texel(column, row + 1) * (1 - across) + texel(column + 1, row + 1) * across;
    return upper * (1 - down) + lower * down;
}

/// Returns a texture's linear value at (s, t); `data` says that its bytes are no sRGB colours.
[[nodiscard]] inline Vec4 sample_texture(const ShadingView& view, std::uint32_t texture, Vec2 st,
                                         const Footprint& footprint, bool data) {
    const TextureRecord& record = view.scene->textures[texture];
    const std::uint32_t levels = view.levels == nullptr ? 1 : view.levels[texture].count;
    const float texels = static_cast<float>(record.width) * static_cast<float>(record.height);
    const float finest = footprint.log_width + 0.5F * std::log2(texels);
    const auto at_level = [&](std::uint32_t level) {
        const TexturePlane plane = texture_plane(view, texture, level);
        if (data) {
            return sample_plane(plane, record, st,
                                [](std::uint8_t b) { return static_cast<float>(b) / 255.0F; });
        }
        const std::array<float, 256>& linear = srgb_to_linear();
        return sample_plane(plane, record, st, [&](std::uint8_t b) { return linear[b]; });
    };
    if (!(finest > 0) || levels < 2 || record.nearest != 0) return at_level(0);
    const float level = std::min(finest, static_cast<float>(levels - 1));
    const auto lower = std::min(static_cast<std::uint32_t>(level), levels - 2);
    const float part = level - static_cast<float>(lower);
    return at_level(lower) * (1 - part) + at_level(lower + 1) * part;
}

}  // namespace raynest
