// The forest's textures, painted at load: sprigs of leaves, needles, fronds and blades with real
// gaps between them, so that the alpha mask decides the picture; bark and ground that tile.
#include "engine/assets/builtin/canvas.h"
#include "engine/assets/builtin/forest_parts.h"
#include "engine/assets/builtin/noise.h"

#include <array>

namespace raynest::forest {
namespace {

Vec2 rotated(const Vec2& v, float angle) {
    const float c = std::cos(angle);
    const float s = std::sin(angle);
    return {c * v.x - s * v.y, s * v.x + c * v.y};
}

Vec3 varied(Random& random, const Vec3& colour, float amount) {
    const float light = 1 + random.uniform(-amount, amount);
    const float warm = random.uniform(-amount, amount) * 0.4F;
    return {colour.x * (light + warm), colour.y * light, colour.z * (light - warm)};
}

/// Paints one leaf with a midrib, side veins and a shaded half.
void paint_leaf(Canvas& canvas, const Vec2& base, const Vec2& tip, float half, const Vec3& colour,
                bool tiled = false) {
    const auto outline = [half](float s) {
        const float bulge = std::sin(pi * std::pow(s, 0.72F));
        return half * std::pow(std::max(bulge, 0.0F), 0.85F);
    };
    const auto shade = [&colour](float s, float t) {
        const float rib = std::abs(t) < 0.07F ? 0.28F : 0.0F;
        const float vein = 0.07F * std::max(0.0F, std::cos(38 * (s - 0.35F * std::abs(t))));
        const float half_shade = t > 0 ? 0.06F : -0.06F;
        return colour * (0.86F + 0.22F * s + rib + vein + half_shade);
    };
    canvas.shape(base, tip, half, outline, shade, tiled);
}

void paint_stem(Canvas& canvas, const Vec2& from, const Vec2& to, float thick, float thin,
                const Vec3& colour) {
    canvas.shape(
        from, to, thick, [=](float s) { return thick + (thin - thick) * s; },
        [&](float, float t) { return colour * (1.1F - 0.3F * std::abs(t)); });
}

/// Paints a twig with alternating leaves inside the cell at (x, y) of `size` pixels.
void paint_sprig(Canvas& canvas, float x, float y, float size, Random random, const Vec3& colour,
                 int pairs, float leaf_length, float leaf_width) {
    Vec2 at(x + size * 0.5F, y + size * 0.985F);
    float heading = random.uniform(-0.08F, 0.08F);
    const float bend = random.uniform(-0.09F, 0.09F);
    const float step = size * 0.66F / static_cast<float>(pairs);
    const auto leaf = [&](float angle, float scale) {
        const Vec2 direction = rotated(Vec2(0, -1), heading + angle);
        const float length = size * leaf_length * scale * random.uniform(0.85F, 1.12F);
        const Vec2 base = at + direction * (size * 0.018F);
        // Stay inside the cell: neighbours in the atlas must not bleed in.
        const Vec2 inside =
            glm::clamp(base + direction * length, Vec2(x, y) + 3.0F, Vec2(x, y) + size - 3.0F);
        paint_leaf(canvas, base, inside, size * leaf_width * scale, varied(random, colour, 0.16F));
    };
    for (int i = 0; i < pairs; ++i) {
        const Vec2 next = at + rotated(Vec2(0, -step), heading);
        paint_stem(canvas, at, next, size * 0.011F, size * 0.009F, {0.32F, 0.25F, 0.13F});
        at = next;
        heading += bend;
        const float fraction = static_cast<float>(i) / static_cast<float>(pairs);
        const float scale = 0.78F + 0.4F * std::sin(pi * (0.25F + 0.6F * fraction));
        const float open = random.uniform(0.75F, 1.15F) - 0.35F * fraction;
        leaf(-open, scale);
        leaf(open + random.uniform(-0.15F, 0.15F), scale);
    }
    leaf(random.uniform(-0.15F, 0.15F), 1.05F);
}

/// Paints 2 x 2 different sprigs.
ImageDescription paint_sprigs(std::uint64_t seed, const Vec3& colour, int pairs, float length,
                              float width) {
    constexpr std::uint32_t cell = 256;
    Canvas canvas(2 * cell, 2 * cell, colour * 0.8F);
    Random random(seed);
    for (std::uint32_t i = 0; i < 4; ++i) {
        paint_sprig(canvas, static_cast<float>(i % 2 * cell), static_cast<float>(i / 2 * cell),
                    static_cast<float>(cell), random.split(), colour, pairs, length, width);
    }
    return canvas.image();
}

/// Paints a flat bough of a spruce: an axis, twigs to both sides, needles on all of them.
ImageDescription paint_needles(std::uint64_t seed) {
    constexpr float size = 256;
    const Vec3 colour(0.25F, 0.42F, 0.24F);
    Canvas canvas(256, 256, colour * 0.8F);
    Random random(seed);
    const auto twig = [&](const Vec2& from, const Vec2& to, float needle) {
        paint_stem(canvas, from, to, 2.2F, 1.2F, {0.27F, 0.19F, 0.11F});
        const float length = glm::length(to - from);
        const int count = static_cast<int>(length / 2.4F);
        for (int i = 0; i < count; ++i) {
            const float s = static_cast<float>(i) / static_cast<float>(count);
            const Vec2 base = glm::mix(from, to, s);
            for (const float side : {-1.0F, 1.0F}) {
                const Vec2 direction =
                    rotated((to - from) / length, side * random.uniform(0.6F, 0.95F));
                const float reach = needle * random.uniform(0.75F, 1.1F) * (1 - 0.35F * s);
                paint_stem(canvas, base, base + direction * reach, 1.7F, 0.6F,
                           varied(random, colour, 0.25F));
            }
        }
    };
    const Vec2 root(size * 0.5F, size - 2);
    twig(root, {size * 0.5F, 16}, 15);
    for (int i = 0; i < 9; ++i) {
        const float s = 0.06F + 0.098F * static_cast<float>(i);
        const Vec2 base(root.x, root.y - s * (size - 20));
        for (const float side : {-1.0F, 1.0F}) {
            const float length = size * (0.44F - 0.36F * s) * random.uniform(0.9F, 1.08F);
            twig(base, base + rotated(Vec2(0, -length), side * random.uniform(0.85F, 1.0F)), 15);
        }
    }
    return canvas.image();
}

ImageDescription paint_frond(std::uint64_t seed) {
    const Vec3 colour(0.33F, 0.5F, 0.18F);
    Canvas canvas(192, 512, colour * 0.8F);
    Random random(seed);
    paint_stem(canvas, {96, 510}, {96, 10}, 3, 1, {0.42F, 0.47F, 0.2F});
    constexpr int pairs = 26;
    for (int i = 0; i < pairs; ++i) {
        const float s = static_cast<float>(i) / pairs;
        const float length = 92 * std::pow(std::sin(pi * (0.13F + 0.84F * s)), 0.8F);
        for (const float side : {-1.0F, 1.0F}) {
            const Vec2 base(96, 470 - s * 452);
            const Vec2 tip =
                base + rotated(Vec2(side * length, 0), -side * random.uniform(0.2F, 0.36F));
            paint_leaf(canvas, base, tip, 8.5F - 4.5F * s, varied(random, colour, 0.14F));
        }
    }
    return canvas.image();
}

ImageDescription paint_blades(std::uint64_t seed) {
    const Vec3 colour(0.42F, 0.52F, 0.2F);
    Canvas canvas(256, 256, colour * 0.8F);
    Random random(seed);
    for (int i = 0; i < 22; ++i) {
        Vec2 at(random.uniform(40, 216), 258);
        float heading = random.uniform(-0.35F, 0.35F);
        const float bend = heading * random.uniform(0.12F, 0.3F);
        const float half = random.uniform(2.6F, 4.4F);
        const float step = random.uniform(18, 30);
        const Vec3 tint = varied(random, colour, 0.22F);
        for (int k = 0; k < 8; ++k) {
            const Vec2 next = at + rotated(Vec2(0, -step), heading);
            const float from = half * (1 - static_cast<float>(k) / 8);
            paint_stem(canvas, at, next, from, from - half / 8,
                       tint * (0.75F + 0.05F * static_cast<float>(k)));
            at = next;
            heading += bend;
        }
    }
    return canvas.image();
}

ImageDescription paint_bark(std::uint64_t seed, bool birch) {
    Canvas canvas(128, 256, Vec3(0), 1);
    for (std::uint32_t y = 0; y < canvas.height(); ++y) {
        for (std::uint32_t x = 0; x < canvas.width(); ++x) {
            const float u = static_cast<float>(x) / 128;
            const float v = static_cast<float>(y) / 256;
            const float streaks = fractal_noise(u * 16, v * 5, 4, 0x10, seed);
            const float marks = fractal_noise(u * 4, v * 32, 3, 0x20, seed + 50);
            Vec3 colour = glm::mix(Vec3(0.2F, 0.15F, 0.1F), Vec3(0.5F, 0.41F, 0.31F), streaks);
            if (birch) {
                const float dark = std::clamp((marks - 0.6F) * 9, 0.0F, 1.0F);
                colour = glm::mix(Vec3(0.86F, 0.84F, 0.79F) * (0.8F + 0.25F * streaks),
                                  Vec3(0.16F, 0.14F, 0.13F), dark);
            }
            canvas.at(x, y) = Vec4(colour, 1);
        }
    }
    return canvas.image();
}

/// Paints moss and earth under fallen leaves.
ImageDescription paint_ground(std::uint64_t seed) {
    Canvas canvas(512, 512, Vec3(0), 1);
    for (std::uint32_t y = 0; y < 512; ++y) {
        for (std::uint32_t x = 0; x < 512; ++x) {
            const float u = static_cast<float>(x) / 512;
            const float v = static_cast<float>(y) / 512;
            const float moss =
                std::clamp(3 * fractal_noise(u * 4, v * 4, 4, 4, seed) - 1.1F, 0.0F, 1.0F);
            const float grain = fractal_noise(u * 64, v * 64, 3, 64, seed + 9);
            const Vec3 colour =
                glm::mix(Vec3(0.42F, 0.33F, 0.21F), Vec3(0.37F, 0.45F, 0.19F), moss);
            canvas.at(x, y) = Vec4(colour * (0.65F + 0.6F * grain), 1);
        }
    }
    Random random(seed + 77);
    const std::array<Vec3, 4> litter{Vec3(0.45F, 0.3F, 0.14F), Vec3(0.36F, 0.25F, 0.13F),
                                     Vec3(0.52F, 0.4F, 0.17F), Vec3(0.3F, 0.33F, 0.13F)};
    for (int i = 0; i < 700; ++i) {
        const Vec2 base(random.uniform(0, 512), random.uniform(0, 512));
        const Vec2 tip = base + rotated(Vec2(random.uniform(12, 24), 0), random.uniform(0, 2 * pi));
        paint_leaf(canvas, base, tip, random.uniform(3.5F, 6.5F),
                   varied(random, litter[random.below(4)], 0.2F), true);
    }
    return canvas.image();
}

}  // namespace

void add_materials(SceneDescription& scene, std::uint64_t seed) {
    scene.images.push_back(paint_ground(seed));
    scene.images.push_back(paint_bark(seed + 1, false));
    scene.images.push_back(paint_bark(seed + 2, true));
    scene.images.push_back(paint_sprigs(seed + 3, {0.32F, 0.47F, 0.16F}, 5, 0.33F, 0.07F));
    scene.images.push_back(paint_sprigs(seed + 4, {0.47F, 0.57F, 0.2F}, 7, 0.2F, 0.058F));
    scene.images.push_back(paint_needles(seed + 5));
    scene.images.push_back(paint_frond(seed + 6));
    scene.images.push_back(paint_blades(seed + 7));
    for (std::uint32_t i = 0; i < scene.images.size(); ++i) {
        const bool tiles = i <= 2;
        const Wrap wrap = tiles ? Wrap::repeat : Wrap::clamp;
        scene.textures.push_back({i, wrap, wrap, false});
    }

    scene.materials.resize(material_count);
    const auto define = [&](MaterialId id, const char* name, std::uint32_t texture,
                            const Vec3& tint, bool masked) {
        MaterialDescription& material = scene.materials[id];
        material.name = name;
        material.base_colour = Vec4(tint, 1);
        material.texture = texture;
        material.alpha_mode = masked ? AlphaMode::mask : AlphaMode::opaque;
        material.double_sided = masked;
    };
    define(ground, "ground", 0, Vec3(1), false);
    define(bark, "bark", 1, Vec3(1), false);
    define(birch_bark, "birch-bark", 2, Vec3(1), false);
    define(leaf_light, "leaf-light", 3, Vec3(1.3F, 1.25F, 1.0F), true);
    define(leaf_mid, "leaf-mid", 3, Vec3(0.85F, 0.9F, 0.8F), true);
    define(leaf_dark, "leaf-dark", 3, Vec3(0.48F, 0.58F, 0.55F), true);
    define(leaf_amber, "leaf-amber", 3, Vec3(3.0F, 1.2F, 0.7F), true);
    define(birch_leaf, "birch-leaf", 4, Vec3(1), true);
    define(needles, "needles", 5, Vec3(1), true);
    define(fern, "fern", 6, Vec3(1), true);
    define(grass, "grass", 7, Vec3(1), true);
    define(rock, "rock", no_id, Vec3(0.3F, 0.3F, 0.28F), false);
}

}  // namespace raynest::forest
