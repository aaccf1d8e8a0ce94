// The items of the builder: 32 bytes each, with boxes whose union is a single maximum.
//
// The loops over items are most of a build (build_loops.h). They use the compilers' vector types,
// because the engine library is compiled for the baseline of its architecture, where Highway has
// scalar code only.
#pragma once

#include "engine/bvh/page_vector.h"
#include "engine/geometry/box.h"

#include <bit>
#include <cstddef>
#include <cstdint>
#include <limits>

namespace raynest::build {

using Float4 = float __attribute__((vector_size(16)));
using Int4 = std::int32_t __attribute__((vector_size(16)));

inline Float4 maximum(Float4 a, Float4 b) {
    return a > b ? a : b;
}
inline Float4 minimum(Float4 a, Float4 b) {
    return a < b ? a : b;
}

/// A box with its lower corner negated. Lane 3 of both halves means nothing.
struct alignas(32) Extent {
    Float4 minus_lower, upper;

    /// Contains nothing: sizes and areas of it are infinite or NaN.
    static Extent none() {
        const float none = -std::numeric_limits<float>::infinity();
        return {Float4{none, none, none, none}, Float4{none, none, none, none}};
    }
    static Extent of(const Box& box) {
        return {Float4{-box.lower.x, -box.lower.y, -box.lower.z, 0},
                Float4{box.upper.x, box.upper.y, box.upper.z, 0}};
    }
    static Extent at(Float4 point) { return {-point, point}; }
    [[nodiscard]] bool is_none() const { return minus_lower[0] + upper[0] < 0; }

    void extend(const Extent& other) {
        minus_lower = maximum(minus_lower, other.minus_lower);
        upper = maximum(upper, other.upper);
    }
    [[nodiscard]] Float4 size() const { return minus_lower + upper; }
    [[nodiscard]] float half_area() const {
        const Float4 s = size();
        return s[0] * s[1] + s[1] * s[2] + s[2] * s[0];
    }
    [[nodiscard]] Box box() const {
        return {{-minus_lower[0], -minus_lower[1], -minus_lower[2]},
                {upper[0], upper[1], upper[2]}};
    }
};

/// One lane of a vector in memory; subscripting by a variable would copy the whole vector first.
inline float lane_of(const Float4& v, int lane) {
    float value;
    __builtin_memcpy(&value, reinterpret_cast<const float*>(&v) + lane, sizeof value);
    return value;
}

/// One thing to be sorted into the tree, or with spatial splits a part of it: its box, with its
/// index in lane 3 of the lower corner.
struct alignas(32) Item {
    Extent extent;

    /// Zeros get one sign: then maxima do not depend on the order of items.
    static Item of(const Extent& extent, std::uint32_t id) {
        Item item{{-(Float4{} - extent.minus_lower), extent.upper + Float4{}}};
        item.extent.minus_lower[3] = std::bit_cast<float>(id);
        return item;
    }
    [[nodiscard]] std::uint32_t id() const {
        return std::bit_cast<std::uint32_t>(lane_of(extent.minus_lower, 3));
    }
    /// Twice the centre of the box; lane 3 is 0, because ids look like denormals, which are slow.
    [[nodiscard]] Float4 center() const {
        const Float4 sum = extent.upper - extent.minus_lower;
        return std::bit_cast<Float4>(std::bit_cast<Int4>(sum) & Int4{-1, -1, -1, 0});
    }
    /// The same, of one axis.
    [[nodiscard]] float center(int axis) const {
        return lane_of(extent.upper, axis) - lane_of(extent.minus_lower, axis);
    }
};
static_assert(sizeof(Item) == 32 && sizeof(Extent) == 32);

/// Items [first, first + count) with `room` >= count places: spatial splits fill the rest.
struct Range {
    std::uint32_t first, count, room;
};

inline Extent centers_of(const Item* items, std::uint32_t count) {
    Extent centers = Extent::none();
    for (std::uint32_t i = 0; i < count; ++i) centers.extend(Extent::at(items[i].center()));
    return centers;
}

/// Below `task_items` a task is not worth its cost; from `wide_items` on even the passes over one
/// node's items are shared out, in parts of `part_items`. All depend on the input alone: so does the
/// order of items.
inline constexpr std::uint32_t task_items = 4096;
inline constexpr std::uint32_t part_items = 1U << 12;
inline constexpr std::uint32_t wide_items = 1U << 14;

}  // namespace raynest::build
