#include "engine/bvh/build_binary.h"

#include "engine/bvh/build_spatial.h"

#include <tbb/parallel_for.h>
#include <tbb/parallel_invoke.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <utility>
#include <vector>

namespace raynest::build {
namespace {

/// So few are never split: one leaf block holds them. Splitting down to 4 instead lowers the SAH
/// cost by 0.5 to 1.7 % and speeds up no ray, but costs 15 % of build time and 16 % of memory.
constexpr std::uint32_t binary_leaf_items = 8;

/// Spatial splits are tried where the halves of a range overlap in more than this share of the
/// whole tree's area (Stich et al.).
constexpr float overlap_min = 1e-4F;

bool is_sound(const Box& box) {
    const Vec3 size = box.upper - box.lower;
    return !box.is_empty() && std::isfinite(size.x + size.y + size.z);
}

}  // namespace

BinaryTree::BinaryTree(const TreeInput& input, const Loops& fastest)
    : input_(input),
      loops_(fastest),
      triangles_only_(input.record_count + input.instance_count == 0),
      splits_triangles_(input.quality == BuildQuality::high && triangles_only_ &&
                        input.corners.size() == input.triangle_count),
      room_(input.boxes.size() + (splits_triangles_ ? input.boxes.size() / 2 : 0)),
      items_(room_),
      nodes_(room_) {
    gather();
    if (input.quality == BuildQuality::fast) order_.emplace(items_.data(), count_, centers_);
}

// Two passes, so that parts know where their sound boxes go.
void BinaryTree::gather() {
    const std::size_t parts = (input_.boxes.size() + part_items - 1) / part_items;
    struct Part {
        std::uint32_t count = 0;
        Extent centers = Extent::none(), bounds = Extent::none();
    };
    Extent bounds = Extent::none();
    std::vector<Part> found(parts);
    const auto for_each_part = [&](auto&& body) {
        tbb::parallel_for(std::size_t{0}, parts, [&](std::size_t part) {
            const std::size_t first = part * part_items;
            body(found[part], first, std::min(first + part_items, input_.boxes.size()));
        });
    };
    for_each_part([&](Part& part, std::size_t i, std::size_t end) {
        for (; i < end; ++i) part.count += static_cast<std::uint32_t>(is_sound(input_.boxes[i]));
    });
    for (Part& part : found) count_ += std::exchange(part.count, count_);
    for_each_part([&](Part& part, std::size_t i, std::size_t end) {
        for (Item* out = items_.data() + part.count; i < end; ++i) {
            if (!is_sound(input_.boxes[i])) continue;
            *out = Item::of(Extent::of(input_.boxes[i]), static_cast<std::uint32_t>(i));
            part.bounds.extend(out->extent);
            part.centers.extend(Extent::at(out++->center()));
        }
    });
    for (const Part& part : found) {
        centers_.extend(part.centers);
        bounds.extend(part.bounds);
    }
    overlap_min_ = overlap_min * bounds.half_area();
}

float BinaryTree::build() {
    const Subtree tree = split({0, count_, static_cast<std::uint32_t>(room_)}, centers_, 1);
    root_ = tree.link;
    box_ = tree.box.box();
    return tree.costs[0];
}

// Recursion is bounded by tree_height_max.
BinaryTree::Subtree BinaryTree::split(const Range& range, const Extent& centers,
                                      std::uint32_t depth) {
    if (may_be_leaf(range)) return leaf(range);
    const Halves halves = halves_of(range, centers, depth);
    Subtree left, right;
    const auto split_left = [&] { left = split(halves.left, halves.left_centers, depth + 1); };
    const auto split_right = [&] { right = split(halves.right, halves.right_centers, depth + 1); };
    if (range.count >= task_items) {
        tbb::parallel_invoke(split_left, split_right);
    } else {
        split_left();
        split_right();
    }
    return join(halves.right.first, left, right);
}

Halves BinaryTree::halves_of(const Range& range, const Extent& centers, std::uint32_t depth) {
    // Halving from here on reaches single items below tree_height_max: the bound on the traversal
    // stack rests on it.
    const auto levels_to_go = static_cast<std::uint32_t>(std::bit_width(range.count - 1));
    if (depth + levels_to_go >= tree_height_max - 1) return halve(items_.data(), range, centers);
    const std::uint32_t along_curve = order_ ? order_->left_count(range) : 0;
    if (along_curve != 0) return cut_at(items_.data(), range, along_curve);
    const ObjectSplit object =
        find_object_split(items_.data() + range.first, range.count, centers, block_items(), loops_);
    // Coincident centres, or areas that overflow.
    if (object.axis < 0) return halve(items_.data(), range, centers);
    if (splits_triangles_) {
        if (const auto halves = halves_in_space(range, object)) return *halves;
    }
    return partition(items_.data(), range, object, loops_);
}

std::optional<Halves> BinaryTree::halves_in_space(const Range& range, const ObjectSplit& object) {
    if (range.room == range.count) return std::nullopt;
    const Extent overlap = {minimum(object.left.minus_lower, object.right.minus_lower),
                            minimum(object.left.upper, object.right.upper)};
    const Float4 size = overlap.size();
    const bool overlaps = size[0] >= 0 && size[1] >= 0 && size[2] >= 0;
    if (!overlaps || !(overlap.half_area() > overlap_min_)) return std::nullopt;
    Extent box = object.left;
    box.extend(object.right);
    const SpatialSplit space =
        find_spatial_split(items_.data(), range, box, input_.corners, block_items());
    if (!(space.cost < object.cost)) return std::nullopt;
    return split_in_space(items_.data(), range, space, input_.corners);
}

bool BinaryTree::may_be_leaf(const Range& range) const {
    if (range.count > binary_leaf_items) return false;
    if (range.count == 1 || triangles_only_) return true;
    const Item* const first = items_.data() + range.first;
    const ChildKind kind = kind_of_item(first->id());
    return kind != ChildKind::instance &&
           std::all_of(first, first + range.count,
                       [&](const Item& item) { return kind_of_item(item.id()) == kind; });
}

BinaryTree::Subtree BinaryTree::leaf(const Range& range) const {
    const Item* const first = items_.data() + range.first;
    Subtree out{Link::leaf(range.count), Extent::none(), {0, range.count}, {}};
    for (std::uint32_t i = 0; i < range.count; ++i) out.box.extend(first[i].extent);
    out.load.kinds = only(kind_of_item(first->id()));
    out.costs.fill(leaf_cost(out.load, out.box.half_area()));
    return out;
}

BinaryTree::Subtree BinaryTree::join(std::uint32_t index, const Subtree& left,
                                     const Subtree& right) {
    Subtree out{Link::inner(index), left.box, left.load, {}};
    out.box.extend(right.box);
    out.load.kinds |= right.load.kinds;
    out.load.count += right.load.count;
    const float area = out.box.half_area();
    const Plan plan = plan_cut(left.costs, right.costs, leaf_cost(out.load, area), area, out.costs);
    const std::uint32_t entries = plan.is_leaf() ? leaf_entries(out.load) : 0;
    nodes_[index] = {out.box.box(), left.link, right.link, plan, 0, entries};
    return out;
}

}  // namespace raynest::build
