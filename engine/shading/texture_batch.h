// Texture lookups of many hits at once: trilinear, in as many lanes as the target's vectors have.
//
// A lane is one bilinear lookup in one level of any texture; lanes of different textures, levels
// and wraps go through the same instructions, so hits need no sorting. The arithmetic is that of
// sample_texture(), step by step: the same bits.
#pragma once

#include "engine/shading/texture_lookup.h"

#include <cstdint>
#include <vector>

namespace raynest {

/// The levels of a scene's textures, laid out for lookups.
class TextureTable {
public:
    explicit TextureTable(const ShadingView& view);

    struct Entry {
        std::uint32_t first = 0;   ///< level 0 in planes
        std::uint32_t levels = 1;  ///< that lookups may use
        float half_log_texels = 0;
        Wrap wrap_s = Wrap::repeat, wrap_t = Wrap::repeat;
        bool nearest = false;
    };
    std::vector<Entry> entries;  ///< one per texture
    std::vector<TexturePlane> planes;
};

class TextureBatch {
public:
    explicit TextureBatch(const TextureTable& table) : table_(table) {}

    /// Writes the texture's linear value at (s, t) to `out` in the next run(); `data` says that its
    /// bytes are no sRGB colours.
    void add(std::uint32_t texture, Vec2 st, const Footprint& footprint, bool data, Vec4* out);
    void run();

private:
    struct Lane {
        TexturePlane plane;
        Vec2 st;
        float weight;
        Wrap wrap_s, wrap_t;
        bool nearest, data;
        bool adds;  ///< to what the lane before it wrote
        Vec4* out;
    };
    const TextureTable& table_;
    std::vector<Lane> lanes_;
};

}  // namespace raynest
