#include "engine/shading/texture_batch.h"

#include "engine/math/highway_part.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>

namespace raynest {

#ifdef RAYNEST_HIGHWAY_TARGET
static_assert(HWY_STATIC_TARGET == RAYNEST_HIGHWAY_TARGET,
              "Highway chose another instruction set than this module's flags ask for");
#endif

namespace {

namespace hn = part::hn;
using Floats = hn::CappedTag<float, 16>;
using Ints = hn::RebindToSigned<Floats>;
using F = hn::Vec<Floats>;
using I = hn::Vec<Ints>;
constexpr std::size_t width = hn::MaxLanes(Floats());
constexpr Floats f32;
constexpr Ints i32;

/// A value per lane, in memory.
template <class T>
struct alignas(64) Column {
    T value[width];
    T& operator[](std::size_t lane) { return value[lane]; }
};
F load(const Column<float>& c) {
    return hn::Load(f32, c.value);
}
I load(const Column<std::int32_t>& c) {
    return hn::Load(i32, c.value);
}

/// Linear values of the 256 bytes of sRGB, then of data.
const float* decode_table() {
    static const std::array<float, 512> table = [] {
        std::array<float, 512> t{};
        std::ranges::copy(srgb_to_linear(), t.begin());
        for (std::size_t i = 0; i < 256; ++i) t[256 + i] = static_cast<float>(i) / 255.0F;
        return t;
    }();
    return table.data();
}

/// wrap_coordinate(), lane by lane.
F wrapped(F s, I wrap) {
    const F half = hn::Set(f32, 0.5F);
    const F one = hn::Set(f32, 1.0F);
    const F two = hn::Set(f32, 2.0F);
    const auto is = [&](Wrap mode) {
        return hn::RebindMask(f32, hn::Eq(wrap, hn::Set(i32, static_cast<std::int32_t>(mode))));
    };
    const F repeated = hn::Sub(s, hn::Floor(s));
    const F period = hn::Sub(s, hn::Mul(two, hn::Floor(hn::Mul(s, half))));
    const F mirrored = hn::IfThenElse(hn::Gt(period, one), hn::Sub(two, period), period);
    F r = hn::IfThenElse(is(Wrap::repeat), repeated, hn::IfThenElse(is(Wrap::mirror), mirrored, s));
    r = hn::IfThenElseZero(hn::Gt(r, hn::Zero(f32)), r);
    return hn::IfThenElse(hn::Lt(r, one), r, one);
}

/// wrap_texel(), lane by lane.
I wrapped_texel(I x, I size, I wrap) {
    const I last = hn::Sub(size, hn::Set(i32, 1));
    const auto repeats = hn::Eq(wrap, hn::Set(i32, static_cast<std::int32_t>(Wrap::repeat)));
    const I below = hn::IfThenElseZero(repeats, last);
    const I above = hn::IfThenZeroElse(repeats, last);
    return hn::IfThenElse(hn::Lt(x, hn::Zero(i32)), below,
                          hn::IfThenElse(hn::Gt(x, last), above, x));
}

/// Along one axis: both texels of each lane, and the share of the second one.
struct Axis {
    Column<std::int32_t> texel[2];
    F share;

    void set(const Column<float>& coordinate, const Column<std::int32_t>& size,
             const Column<std::int32_t>& wrap, const Column<float>& shift) {
        const I wraps = load(wrap);
        const I sizes = load(size);
        const F x = hn::Sub(hn::Mul(wrapped(load(coordinate), wraps), hn::ConvertTo(f32, sizes)),
                            load(shift));
        const F floor = hn::Floor(x);
        // A nearest texel, which is not shifted, has no share of its neighbour.
        share = hn::IfThenZeroElse(hn::Eq(load(shift), hn::Zero(f32)), hn::Sub(x, floor));
        const I first = hn::ConvertTo(i32, floor);
        hn::Store(wrapped_texel(first, sizes, wraps), i32, texel[0].value);
        hn::Store(wrapped_texel(hn::Add(first, hn::Set(i32, 1)), sizes, wraps), i32,
                  texel[1].value);
    }
};

F mix(F a, F b, F share) {
    return hn::Add(hn::Mul(a, hn::Sub(hn::Set(f32, 1.0F), share)), hn::Mul(b, share));
}

}  // namespace

TextureTable::TextureTable(const ShadingView& view) {
    for (std::uint32_t i = 0; i < view.scene->texture_count; ++i) {
        const TextureRecord& record = view.scene->textures[i];
        Entry entry;
        entry.first = static_cast<std::uint32_t>(planes.size());
        entry.nearest = record.nearest != 0;
        if (view.levels != nullptr && !entry.nearest) entry.levels = view.levels[i].count;
        const float texels = static_cast<float>(record.width) * static_cast<float>(record.height);
        entry.half_log_texels = 0.5F * std::log2(texels);
        entry.wrap_s = record.wrap_s;
        entry.wrap_t = record.wrap_t;
        for (std::uint32_t level = 0; level < entry.levels; ++level)
            planes.push_back(texture_plane(view, i, level));
        entries.push_back(entry);
    }
}

void TextureBatch::add(std::uint32_t texture, Vec2 st, const Footprint& footprint, bool data,
                       Vec4* out) {
    const TextureTable::Entry& entry = table_.entries[texture];
    const TexturePlane* planes = table_.planes.data() + entry.first;
    const float finest = footprint.log_width + entry.half_log_texels;
    const auto add_lane = [&](std::uint32_t level, float weight, bool adds) {
        lanes_.push_back({planes[level], st, weight, entry.wrap_s, entry.wrap_t, entry.nearest,
                          data, adds, out});
    };
    if (!(finest > 0) || entry.levels < 2) {
        add_lane(0, 1, false);
        return;
    }
    const float level = std::min(finest, static_cast<float>(entry.levels - 1));
    const auto lower = std::min(static_cast<std::uint32_t>(level), entry.levels - 2);
    const float part = level - static_cast<float>(lower);
    add_lane(lower, 1 - part, false);
    add_lane(lower + 1, part, true);
}

void TextureBatch::run() {
    const float* const table = decode_table();
    Column<float> s, t, shift, weight, values[4];
    Column<std::int32_t> wrap_s, wrap_t, columns, rows, decode, texels[4];
    const std::uint8_t* base[width];
    for (std::size_t first = 0; first < lanes_.size(); first += width) {
        const std::size_t count = std::min(width, lanes_.size() - first);
        for (std::size_t i = 0; i < width; ++i) {
            // The last lanes repeat the last lookup.
            const Lane& lane = lanes_[first + std::min(i, count - 1)];
            s[i] = lane.st.x;
            t[i] = lane.st.y;
            shift[i] = lane.nearest ? 0.0F : 0.5F;
            weight[i] = lane.weight;
            wrap_s[i] = static_cast<std::int32_t>(lane.wrap_s);
            wrap_t[i] = static_cast<std::int32_t>(lane.wrap_t);
            columns[i] = static_cast<std::int32_t>(lane.plane.width);
            rows[i] = static_cast<std::int32_t>(lane.plane.height);
            decode[i] = lane.data ? 256 : 0;
            base[i] = lane.plane.rgba;
        }
        Axis across, down;
        across.set(s, columns, wrap_s, shift);
        down.set(t, rows, wrap_t, shift);
        for (std::size_t i = 0; i < width; ++i) {
            for (std::size_t corner = 0; corner < 4; ++corner) {
                const auto row = static_cast<std::size_t>(down.texel[corner >> 1][i]);
                const auto column = static_cast<std::size_t>(across.texel[corner & 1][i]);
                const auto stride = static_cast<std::size_t>(columns[i]);
                std::memcpy(&texels[corner][i], base[i] + 4 * (row * stride + column), 4);
            }
        }
        for (int channel = 0; channel < 4; ++channel) {
            const I offset = channel == 3 ? hn::Set(i32, 256) : load(decode);
            const auto value = [&](std::size_t corner) {
                const I byte = hn::And(hn::ShiftRightSame(load(texels[corner]), 8 * channel),
                                       hn::Set(i32, 255));
                return hn::GatherIndex(f32, table, hn::Add(byte, offset));
            };
            const F upper = mix(value(0), value(1), across.share);
            const F lower = mix(value(2), value(3), across.share);
            hn::Store(hn::Mul(mix(upper, lower, down.share), load(weight)), f32,
                      values[channel].value);
        }
        for (std::size_t i = 0; i < count; ++i) {
            const Vec4 value(values[0][i], values[1][i], values[2][i], values[3][i]);
            const Lane& lane = lanes_[first + i];
            *lane.out = lane.adds ? *lane.out + value : value;
        }
    }
    lanes_.clear();
}

}  // namespace raynest
