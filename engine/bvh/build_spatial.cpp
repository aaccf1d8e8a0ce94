#include "engine/bvh/build_spatial.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_reduce.h>

#include <algorithm>
#include <cmath>
#include <vector>

namespace raynest::build {
namespace {

constexpr int bin_count = 16;
constexpr float pad_relative = 0x1p-18F;

struct Parts {
    Extent left, right;
};

bool is_empty(const Extent& e) {
    const Float4 size = e.size();
    return !(size[0] >= 0 && size[1] >= 0 && size[2] >= 0);
}

Extent common(const Extent& a, const Extent& b) {
    return {minimum(a.minus_lower, b.minus_lower), minimum(a.upper, b.upper)};
}

/// The boxes of a reference's parts on both sides of a plane that its box contains.
Parts chop(const Corners& corners, const Extent& box, int axis, float plane) {
    Parts parts{Extent::none(), Extent::none()};
    Float4 vertex[3];
    float reach = 0;
    for (std::size_t k = 0; k < 3; ++k) {
        const Vec3& p = corners[k];
        vertex[k] = Float4{p.x, p.y, p.z, 0};
        reach = std::max({reach, std::abs(p.x), std::abs(p.y), std::abs(p.z)});
        if (p[axis] <= plane) parts.left.extend(Extent::at(vertex[k]));
        if (p[axis] >= plane) parts.right.extend(Extent::at(vertex[k]));
    }
    for (std::size_t k = 0; k < 3; ++k) {
        const Float4& a = vertex[k];
        const Float4& b = vertex[(k + 1) % 3];
        const float from = lane_of(a, axis), to = lane_of(b, axis);
        if (!((from < plane && plane < to) || (to < plane && plane < from))) continue;
        const Extent cut = Extent::at(a + (b - a) * ((plane - from) / (to - from)));
        parts.left.extend(cut);
        parts.right.extend(cut);
    }
    const float pad = pad_relative * reach;
    for (Extent* part : {&parts.left, &parts.right}) {
        part->minus_lower += pad;
        part->upper += pad;
        *part = common(*part, box);
        // The box of a reference that was cut before holds only a part of its triangle, perhaps none of
        // it on this side of the plane: then the side gets the box, cut at the plane.
        if (!is_empty(*part)) continue;
        *part = box;
        if (part == &parts.left) {
            part->upper[axis] = std::min(part->upper[axis], plane + pad);
        } else {
            part->minus_lower[axis] = std::min(part->minus_lower[axis], pad - plane);
        }
    }
    return parts;
}

struct SpatialBins {
    Extent box[3][bin_count];
    std::uint32_t begin[3][bin_count] = {}, end[3][bin_count] = {};

    SpatialBins() {
        for (auto& row : box) std::fill(std::begin(row), std::end(row), Extent::none());
    }
    void join(const SpatialBins& other) {
        for (int axis = 0; axis < 3; ++axis) {
            for (int b = 0; b < bin_count; ++b) {
                box[axis][b].extend(other.box[axis][b]);
                begin[axis][b] += other.begin[axis][b];
                end[axis][b] += other.end[axis][b];
            }
        }
    }
};

/// Planes at equal distances through a box.
struct Planes {
    Float4 lower, width, scale;

    explicit Planes(const Extent& box)
        : lower(-box.minus_lower),
          width(box.size() * (1.0F / bin_count)),
          scale{} {
        for (int axis = 0; axis < 3; ++axis) {
            if (width[axis] > 0 && std::isfinite(1 / width[axis])) scale[axis] = 1 / width[axis];
        }
    }
    [[nodiscard]] float plane(int axis, int bin) const {
        return lower[axis] + width[axis] * static_cast<float>(bin);
    }
    [[nodiscard]] int bin_of(int axis, float x) const {
        return static_cast<int>(
            std::clamp((x - lower[axis]) * scale[axis], 0.0F, float{bin_count - 1}));
    }
};

void add(SpatialBins& bins, const Item& item, const Planes& planes,
         std::span<const Corners> corners) {
    for (int axis = 0; axis < 3; ++axis) {
        if (planes.scale[axis] == 0) continue;
        const int first = planes.bin_of(axis, -lane_of(item.extent.minus_lower, axis));
        const int last = planes.bin_of(axis, lane_of(item.extent.upper, axis));
        Extent rest = item.extent;
        for (int b = first; b < last; ++b) {
            const Parts parts = chop(corners[item.id()], rest, axis, planes.plane(axis, b + 1));
            bins.box[axis][b].extend(parts.left);
            rest = parts.right;
        }
        bins.box[axis][last].extend(rest);
        ++bins.begin[axis][first];
        ++bins.end[axis][last];
    }
}

SpatialBins fill(const Item* items, std::uint32_t count, const Planes& planes,
                 std::span<const Corners> corners) {
    using Part = tbb::blocked_range<std::uint32_t>;
    const auto add_part = [&](const Part& part, SpatialBins bins) {
        for (std::uint32_t i = part.begin(); i < part.end(); ++i) {
            add(bins, items[i], planes, corners);
        }
        return bins;
    };
    if (count < task_items) return add_part(Part(0, count), SpatialBins());
    return tbb::parallel_reduce(Part(0, count, task_items), SpatialBins(), add_part,
                                [](SpatialBins a, const SpatialBins& b) {
                                    a.join(b);
                                    return a;
                                });
}

}  // namespace

SpatialSplit find_spatial_split(const Item* items, const Range& range, const Extent& box,
                                std::span<const Corners> corners, std::uint32_t block_items) {
    const Planes planes(box);
    const SpatialBins bins = fill(items + range.first, range.count, planes, corners);
    const auto blocks = [&](std::uint32_t n) {
        return static_cast<float>((n + block_items - 1) / block_items);
    };
    SpatialSplit best;
    for (int axis = 0; axis < 3; ++axis) {
        if (planes.scale[axis] == 0) continue;
        Extent right[bin_count];
        std::uint32_t right_count[bin_count];
        Extent side = Extent::none();
        std::uint32_t count = 0;
        for (int b = bin_count - 1; b > 0; --b) {
            side.extend(bins.box[axis][b]);
            count += bins.end[axis][b];
            right[b] = side;
            right_count[b] = count;
        }
        side = Extent::none();
        count = 0;
        for (int b = 1; b < bin_count; ++b) {
            side.extend(bins.box[axis][b - 1]);
            count += bins.begin[axis][b - 1];
            if (count == 0 || right_count[b] == 0) continue;
            const float cost =
                side.half_area() * blocks(count) + right[b].half_area() * blocks(right_count[b]);
            if (!(cost < best.cost)) continue;
            best = {axis, cost, planes.plane(axis, b), side, right[b], count, right_count[b]};
        }
    }
    return best;
}

namespace {

/// References that belong to one side, and the bounds of their centres.
struct Side {
    std::vector<Item> items;
    Extent centers = Extent::none();

    void add(const Item& item) {
        items.push_back(item);
        centers.extend(Extent::at(item.center()));
    }
};
struct Sides {
    Side left, right;
};

/// The references of a part of a range, in their order.
Sides sides_of(std::span<const Item> items, const SpatialSplit& split,
               std::span<const Corners> corners) {
    Sides sides;
    const auto left_count = static_cast<float>(split.left_count);
    const auto right_count = static_cast<float>(split.right_count);
    const float both = split.left.half_area() * left_count + split.right.half_area() * right_count;
    for (const Item& item : items) {
        if (lane_of(item.extent.upper, split.axis) <= split.plane) {
            sides.left.add(item);
            continue;
        }
        if (-lane_of(item.extent.minus_lower, split.axis) >= split.plane) {
            sides.right.add(item);
            continue;
        }
        // A reference that hardly enlarges one side is not cut.
        Extent with_left = split.left, with_right = split.right;
        with_left.extend(item.extent);
        with_right.extend(item.extent);
        const float only_left =
            with_left.half_area() * left_count + split.right.half_area() * (right_count - 1);
        const float only_right =
            split.left.half_area() * (left_count - 1) + with_right.half_area() * right_count;
        if (both <= std::min(only_left, only_right)) {
            const Parts parts = chop(corners[item.id()], item.extent, split.axis, split.plane);
            sides.left.add(Item::of(parts.left, item.id()));
            sides.right.add(Item::of(parts.right, item.id()));
        } else {
            (only_left <= only_right ? sides.left : sides.right).add(item);
        }
    }
    return sides;
}

}  // namespace

std::optional<Halves> split_in_space(Item* items, const Range& range, const SpatialSplit& split,
                                     std::span<const Corners> corners) {
    const std::uint32_t part_count = (range.count + task_items - 1) / task_items;
    std::vector<Sides> parts(part_count);
    const auto for_each_part = [&](const auto& body) {
        if (part_count == 1) return body(0U);
        tbb::parallel_for(0U, part_count, body);
    };
    for_each_part([&](std::uint32_t part) {
        const std::uint32_t first = part * task_items;
        const std::uint32_t count = std::min(task_items, range.count - first);
        parts[part] = sides_of({items + range.first + first, count}, split, corners);
    });
    // Where the next part goes.
    struct Place {
        std::size_t left = 0, right = 0;
    };
    std::vector<Place> places(part_count + 1);
    for (std::uint32_t part = 0; part < part_count; ++part) {
        places[part + 1] = {places[part].left + parts[part].left.items.size(),
                            places[part].right + parts[part].right.items.size()};
    }
    const auto [left, right] = places[part_count];
    if (left + right > range.room || left == 0 || right == 0 || left >= range.count ||
        right >= range.count) {
        return std::nullopt;
    }
    Halves halves =
        share_room(range, static_cast<std::uint32_t>(left), static_cast<std::uint32_t>(right));
    for_each_part([&](std::uint32_t part) {
        Sides& sides = parts[part];
        std::ranges::copy(sides.left.items, items + halves.left.first + places[part].left);
        std::ranges::copy(sides.right.items, items + halves.right.first + places[part].right);
        sides.left.items = {};
        sides.right.items = {};
    });
    for (const Sides& sides : parts) {
        halves.left_centers.extend(sides.left.centers);
        halves.right_centers.extend(sides.right.centers);
    }
    return halves;
}

}  // namespace raynest::build
