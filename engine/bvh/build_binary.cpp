#include "engine/bvh/build_binary.h"

#include "engine/bvh/build_spatial.h"

#include <tbb/parallel_for.h>
#include <tbb/parallel_invoke.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <vector>

namespace raynest::build {
namespace {

/// So few are never split: one leaf block holds them. Splitting down to 4 instead lowers the SAH
/// cost by 0.5 to 1.7 % and speeds up no ray, but costs 15 % of build time and 16 % of memory.
constexpr std::uint32_t binary_leaf_items = 8;

/// Spatial splits are tried where the halves of a range overlap in more than this share of the
/// whole tree's area (Stich et al.).
constexpr float overlap_min = 1e-4F;

/// Boxes of triangles that are made at once: few enough to stay in the nearest cache.
constexpr std::size_t boxes_at_once = 256;

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
      room_(input.size() + (splits_triangles_ ? input.size() / 2 : 0)),
      items_(room_),
      nodes_(room_) {
    gather();
    if (input.quality == BuildQuality::fast) order_.emplace(items_.data(), count_, centers_);
}

void BinaryTree::gather_part(std::size_t first, std::span<Item> out, Part& part) const {
    const std::size_t made = input_.triangle_boxes ? input_.triangle_count : 0;
    const auto add = [&](std::span<const Box> boxes, std::size_t id) {
        for (const Box& box : boxes) {
            if (is_sound(box)) {
                Item& item = out[part.count++] =
                    Item::of(Extent::of(box), static_cast<std::uint32_t>(id));
                part.bounds.extend(item.extent);
                part.centers.extend(Extent::at(item.center()));
            }
            ++id;
        }
    };
    const std::size_t end = first + out.size();
    while (first < std::min(made, end)) {
        Box boxes[boxes_at_once];
        const std::span<Box> some(boxes, std::min(boxes_at_once, std::min(made, end) - first));
        input_.triangle_boxes(static_cast<std::uint32_t>(first), some);
        add(some, first);
        first += some.size();
    }
    if (first < end) add(input_.boxes.subspan(first - made, end - first), first);
}

void BinaryTree::gather() {
    const std::size_t parts = (input_.size() + task_items - 1) / task_items;
    std::vector<Part> found(parts);
    tbb::parallel_for(std::size_t{0}, parts, [&](std::size_t part) {
        const std::size_t first = part * task_items;
        const std::size_t count = std::min(std::size_t{task_items}, input_.size() - first);
        gather_part(first, {items_.data() + first, count}, found[part]);
    });
    Extent bounds = Extent::none();
    for (std::size_t part = 0; part < parts; ++part) {
        // Close the gaps of items that were left out.
        Item* const from = items_.data() + part * task_items;
        if (count_ != part * task_items) std::copy_n(from, found[part].count, &items_[count_]);
        count_ += found[part].count;
        centers_.extend(found[part].centers);
        bounds.extend(found[part].bounds);
    }
    overlap_min_ = overlap_min * bounds.half_area();
}

float BinaryTree::build() {
    const Subtree tree = build_all();
    root_ = tree.link;
    box_ = tree.box.box();
    return tree.costs[0];
}

BinaryTree::Subtree BinaryTree::build_all() {
    if (order_ || splits_triangles_ || count_ < cells_from) {
        return split_in_tasks({0, count_, static_cast<std::uint32_t>(room_)}, centers_, 1);
    }
    const CellTree cells(items_, count_, centers_, block_items(), loops_);
    return split_cells(cells, cells.root(), 1);
}

BinaryTree::Subtree BinaryTree::split_cells(const CellTree& tree, const CellTree::Cells& cells,
                                            std::uint32_t depth) {
    if (cells.cut == 0) return split_in_tasks(tree.items_of(cells), Extent::none(), depth);
    const CellTree::Cells left_cells = tree.left_of(cells), right_cells = tree.right_of(cells);
    Subtree left, right;
    tbb::parallel_invoke([&] { left = split_cells(tree, left_cells, depth + 1); },
                         [&] { right = split_cells(tree, right_cells, depth + 1); });
    return join(NodePool::Run(nodes_, 1).next(), tree.items_of(right_cells).first, left, right);
}

// Recursion is bounded by tree_height_max.
BinaryTree::Subtree BinaryTree::split_in_tasks(const Range& range, const Extent& centers,
                                               std::uint32_t depth) {
    if (range.count < task_items) {
        NodePool::Run places(nodes_, range.room - 1);
        return split(range, centers, depth, places);
    }
    const Halves halves = halves_of(range, centers, depth);
    Subtree left, right;
    tbb::parallel_invoke(
        [&] { left = split_in_tasks(halves.left, halves.left_centers, depth + 1); },
        [&] { right = split_in_tasks(halves.right, halves.right_centers, depth + 1); });
    return join(NodePool::Run(nodes_, 1).next(), halves.right.first, left, right);
}

BinaryTree::Subtree BinaryTree::split(const Range& range, const Extent& centers,
                                      std::uint32_t depth, NodePool::Run& places) {
    if (may_be_leaf(range)) return leaf(range);
    const Halves halves = halves_of(range, centers, depth);
    const Subtree left = split(halves.left, halves.left_centers, depth + 1, places);
    const Subtree right = split(halves.right, halves.right_centers, depth + 1, places);
    return join(places.next(), halves.right.first, left, right);
}

Halves BinaryTree::halves_of(const Range& range, const Extent& known, std::uint32_t depth) {
    // Halving from here on reaches single items below tree_height_max: the bound on the traversal
    // stack rests on it.
    const auto levels_to_go = static_cast<std::uint32_t>(std::bit_width(range.count - 1));
    const bool is_deep = depth + levels_to_go >= tree_height_max - 1;
    const std::uint32_t along_curve = order_ && !is_deep ? order_->left_count(range) : 0;
    if (along_curve != 0) return share_room(range, along_curve, range.count - along_curve);
    // Cuts along the curve leave the centres' bounds to those who need them.
    const Extent centers =
        known.is_none() ? centers_of(items_.data() + range.first, range.count) : known;
    if (is_deep) return halve(items_.data(), range, centers);
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

BinaryTree::Subtree BinaryTree::join(std::uint32_t index, std::uint32_t right_first,
                                     const Subtree& left, const Subtree& right) {
    Subtree out{Link::inner(index), left.box, left.load, {}};
    out.box.extend(right.box);
    out.load.kinds |= right.load.kinds;
    out.load.count += right.load.count;
    const float area = out.box.half_area();
    const Plan plan = plan_cut(left.costs, right.costs, leaf_cost(out.load, area), area, out.costs);
    const std::uint32_t entries = plan.is_leaf() ? leaf_entries(out.load) : 0;
    nodes_[index] = {out.box.box(), left.link, right.link, right_first, plan, 0, entries};
    return out;
}

}  // namespace raynest::build
