// The builder's loops for one target: build_loops.cpp reads this file once for each, in a namespace
// of its own, and names the type that holds a whole box (Whole).

/// Adds a box that stands for some items to its bins.
inline void bin_one(Bins& bins, const Item& item, const BinMap& map, std::int32_t items = 1) {
    const Whole whole = Whole::of(item.extent);
    const Int4 bin = map.bins_of(item.center());
    whole.extend(bins.box[bin[0]][0]);
    whole.extend(bins.box[bin[1]][1]);
    whole.extend(bins.box[bin[2]][2]);
    bins.count[bin[0]][0] += items;
    bins.count[bin[1]][1] += items;
    bins.count[bin[2]][2] += items;
}

// Neighbours often share a bin, and then each waits until the one before is stored. So items of
// four places take turns.
inline void bin_all(Bins& bins, const Item* items, std::uint32_t count, const BinMap& map) {
    const std::uint32_t quarter = count / 4;
    for (std::uint32_t i = 0; i < quarter; ++i) {
        bin_one(bins, items[i], map);
        bin_one(bins, items[quarter + i], map);
        bin_one(bins, items[2 * quarter + i], map);
        bin_one(bins, items[3 * quarter + i], map);
    }
    for (std::uint32_t i = 4 * quarter; i < count; ++i) bin_one(bins, items[i], map);
}

inline void bin_all_cells(Bins& bins, const Item* cells, std::uint32_t count, const BinMap& map,
                          const std::uint32_t* sizes) {
    for (std::uint32_t i = 0; i < count; ++i) {
        bin_one(bins, cells[i], map, static_cast<std::int32_t>(sizes[cells[i].id()]));
    }
}

/// Half areas of three boxes, in lanes 0..2.
inline Float4 half_areas(const Whole (&boxes)[3]) {
    const Float4 a = boxes[0].size(), b = boxes[1].size(), c = boxes[2].size();
    const Float4 ab = __builtin_shufflevector(a, b, 0, 4, 1, 5);  // ax bx ay by
    const Float4 x = __builtin_shufflevector(ab, c, 0, 1, 4, 4);
    const Float4 y = __builtin_shufflevector(ab, c, 2, 3, 5, 5);
    const Float4 z =
        __builtin_shufflevector(__builtin_shufflevector(a, b, 2, 6, 2, 6), c, 0, 1, 6, 6);
    return x * y + y * z + z * x;
}

inline ObjectSplit cheapest_plane(const Bins& bins, const BinMap& map, std::uint32_t block_items) {
    // Lane = axis from here on. A side without items has an infinite or NaN cost: never the least.
    const auto round_up = static_cast<std::int32_t>(block_items - 1);
    const auto shift = static_cast<std::int32_t>(lowest_bit(block_items));
    const auto blocks = [&](Int4 n) {
        return __builtin_convertvector((n + round_up) >> shift, Float4);
    };
    Float4 right_cost[bins_max];
    Whole box[3] = {Whole::none(), Whole::none(), Whole::none()};
    Int4 n{};
    for (int b = map.bins - 1; b > 0; --b) {
        for (int axis = 0; axis < 3; ++axis) box[axis].extend(Whole::of(bins.box[b][axis]));
        n += Int4{bins.count[b][0], bins.count[b][1], bins.count[b][2], 0};
        right_cost[b] = half_areas(box) * blocks(n);
    }
    for (Whole& whole : box) whole = Whole::none();
    n = Int4{};
    constexpr float infinity = std::numeric_limits<float>::infinity();
    Float4 best{infinity, infinity, infinity, infinity};
    Int4 best_bin{};
    for (int b = 0; b + 1 < map.bins; ++b) {
        for (int axis = 0; axis < 3; ++axis) box[axis].extend(Whole::of(bins.box[b][axis]));
        n += Int4{bins.count[b][0], bins.count[b][1], bins.count[b][2], 0};
        const Float4 cost = half_areas(box) * blocks(n) + right_cost[b + 1];
        const Int4 better = cost < best;
        best = better ? cost : best;
        best_bin = better ? Int4{} + b : best_bin;
    }

    ObjectSplit split;
    for (int axis = 0; axis < 3; ++axis) {
        if (!(best[axis] < split.cost)) continue;
        split.cost = best[axis];
        split.axis = axis;
    }
    if (split.axis < 0) return split;
    const int at = best_bin[split.axis];
    split.origin = map.origin[split.axis];
    split.scale = map.scale[split.axis];
    split.plane = static_cast<float>(at + 1);
    for (int b = 0; b < map.bins; ++b) {
        (b <= at ? split.left : split.right).extend(bins.box[b][split.axis]);
    }
    return split;
}

// Without branches: which side an item belongs to is often a coin's toss. Every item changes places
// with the first right one; if it is right itself, that one is put back behind it by the next left.
inline SidePass partition_all(Item* items, std::uint32_t count, const ObjectSplit& split) {
    std::uint32_t left = 0;
    Whole left_centers = Whole::none(), right_centers = Whole::none();
    for (std::uint32_t i = 0; i < count; ++i) {
        const Whole item = Whole::of(items[i].extent);
        const Whole center = Whole::at(items[i].center());
        const bool is_left = split.is_left(items[i]);
        Whole::of(items[left].extent).store(items[i].extent);
        item.store(items[left].extent);
        left_centers.extend_if(center, is_left);
        right_centers.extend_if(center, !is_left);
        left += is_left ? 1 : 0;
    }
    SidePass sides;
    sides.left = left;
    left_centers.store(sides.left_centers);
    right_centers.store(sides.right_centers);
    return sides;
}
