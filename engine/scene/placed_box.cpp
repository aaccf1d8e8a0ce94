#include "engine/scene/placed_box.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <utility>

namespace raynest {
namespace {

// A direction in double: products of floats are exact, and sums far more precise than a float.
using Direction = std::array<double, 3>;

/// The extent of boxes along a direction: uses their upper sides where the direction is positive.
class Reach {
public:
    explicit Reach(const Direction& direction, double start = 0)
        : direction_(direction),
          start_(start) {}

    /// Returns the extent for boxes inside an instance; `padding` bounds the rounding per axis.
    [[nodiscard]] Reach through(const Transform& to_parent, double padding) const {
        Direction inner{};
        double start = start_;
        for (std::size_t row = 0; row < 3; ++row) {
            const float* m = &to_parent.m[4 * row];
            for (std::size_t axis = 0; axis < 3; ++axis) {
                inner[axis] += direction_[row] * static_cast<double>(m[axis]);
            }
            start += direction_[row] * static_cast<double>(m[3]);
            start += padding * std::abs(direction_[row]);
        }
        return Reach(inner, start);
    }

    [[nodiscard]] double of(const Box& box) const {
        double sum = start_;
        for (int axis = 0; axis < 3; ++axis) {
            const float side = points_up(axis) ? box.upper[axis] : box.lower[axis];
            sum += along(axis) * static_cast<double>(side);
        }
        return sum;
    }

    /// Returns the extents of all eight children; undefined for empty slots.
    [[nodiscard]] std::array<double, 8> of(const Node& node) const {
        std::array<double, 8> sums;
        sums.fill(start_);
        for (int axis = 0; axis < 3; ++axis) {
            const float* sides = points_up(axis) ? node.upper[axis] : node.lower[axis];
            for (std::size_t slot = 0; slot < 8; ++slot) {
                sums[slot] += along(axis) * static_cast<double>(sides[slot]);
            }
        }
        return sums;
    }

private:
    [[nodiscard]] double along(int axis) const {
        return direction_[static_cast<std::size_t>(axis)];
    }
    [[nodiscard]] bool points_up(int axis) const { return along(axis) >= 0; }

    Direction direction_;
    double start_;
};

/// Finds the extent of an object along a direction, or an upper bound. Visits the farthest child
/// first, and skips children that do not reach beyond the leaves found so far. Descends into
/// instances, because their own boxes have other axes.
///
/// A few nodes are enough. If they are not, many leaves reach nearly as far, and it matters little
/// which of them decides. Measured on the forests of tests/bench: rays through nested instances are
/// 1.13 times as fast as with transformed boxes, through one level 1.08 times. Descending into
/// instances saves 4 % of the entries at three levels and 1 % of the time; 256 nodes save no more
/// than 32, and 8 half as much.
///
/// The exact distance uses the vertices of leaves without padding, and may open far more nodes.
/// Boxes contain their vertices, so pruning by boxes is safe.
class Farthest {
public:
    enum class Aim { bound, exact };
    Farthest(const Content& content, std::uint32_t object, const Direction& direction,
             Aim aim = Aim::bound)
        : content_(content),
          exact_(aim == Aim::exact),
          opened_max_(exact_ ? 1 << 16 : 32) {
        enter(object, Reach(direction), std::numeric_limits<double>::infinity());
    }
    [[nodiscard]] double distance() const { return farthest_; }

private:
    /// An object in a placement.
    struct Level {
        const std::uint32_t object;
        const Tree& tree;
        const Reach reach;
    };

    /// Enters an object; `most` bounds its extent.
    void enter(std::uint32_t object, const Reach& reach, double most) {
        const Tree& tree = content_.trees[object];
        visit({object, tree, reach}, tree.root, std::min(most, reach.of(tree.bounds)));
    }

    void visit(const Level& level, std::uint32_t child, double most) {
        const bool is_instance = is_leaf(child) && kind_of(child) == ChildKind::instance;
        if (exact_ && is_leaf(child) && !is_instance) most = std::min(most, leaf(level, child));
        if ((is_leaf(child) && !is_instance) || opened_ == opened_max_) {
            farthest_ = std::max(farthest_, most);
            return;
        }
        ++opened_;
        if (is_instance) {
            const std::size_t instance =
                content_.objects[level.object].first_instance + leaf_instance(child);
            enter(content_.instances[instance].object,
                  level.reach.through(content_.instance_infos[instance].to_parent,
                                      exact_ ? 0 : content_.instance_paddings[instance]),
                  most);
            return;
        }
        const Node& node = level.tree.nodes[child];
        std::array<double, 8> distances = level.reach.of(node);
        for (std::size_t slot = 0; slot < 8; ++slot) {
            const bool valid = (node.valid() >> slot & 1U) != 0;
            distances[slot] = valid ? std::min(most, distances[slot]) : nothing;
        }
        for (;;) {
            const auto next = std::max_element(distances.begin(), distances.end());
            if (*next <= farthest_) return;
            visit(level, node.child[next - distances.begin()], std::exchange(*next, nothing));
        }
    }

    /// Returns the extent of a leaf: of its triangles' vertices, or of its records' boxes.
    [[nodiscard]] double leaf(const Level& level, std::uint32_t child) const {
        const ObjectDescription& source = *content_.sources[level.object];
        double farthest = nothing;
        if (kind_of(child) == ChildKind::records) {
            for (std::uint32_t i = 0; i < leaf_count(child); ++i) {
                const std::uint32_t record = level.tree.record_order[leaf_first(child) + i];
                farthest = std::max(farthest, level.reach.of(source.record_bounds[record]));
            }
            return farthest;
        }
        const std::size_t first = std::size_t{8} * leaf_first(child);
        for (std::size_t lane = first; lane < first + 8 * leaf_count(child); ++lane) {
            std::size_t triangle = level.tree.block_lanes[lane];
            if (triangle == no_id) continue;
            auto geometry = source.geometries.begin();
            for (; triangle >= geometry->indices.size() / 3; ++geometry)
                triangle -= geometry->indices.size() / 3;
            for (std::size_t corner = 0; corner < 3; ++corner) {
                const Vec3& point = geometry->positions[geometry->indices[3 * triangle + corner]];
                farthest = std::max(farthest, level.reach.of(Box{point, point}));
            }
        }
        return farthest;
    }

    static constexpr double nothing = -std::numeric_limits<double>::infinity();
    const Content& content_;
    const bool exact_;
    const int opened_max_;
    double farthest_ = nothing;
    int opened_ = 0;
};

}  // namespace

PlacedBox placed_box(const Content& content, std::uint32_t child, const Transform& to_parent,
                     float error) {
    const Box& bounds = content.trees[child].bounds;
    if (bounds.is_empty()) return {};
    double lower[3], upper[3];
    double size = 0;  // the largest coordinate involved
    for (std::size_t row = 0; row < 3; ++row) {
        const float* m = &to_parent.m[4 * row];
        const Direction axis{m[0], m[1], m[2]};
        const Direction back{-axis[0], -axis[1], -axis[2]};
        const auto moved = static_cast<double>(m[3]);
        upper[row] = moved + Farthest(content, child, axis).distance();
        lower[row] = moved - Farthest(content, child, back).distance();
        size = std::max({size, std::abs(moved), std::abs(moved + Reach(axis).of(bounds)),
                         std::abs(moved - Reach(back).of(bounds))});
    }

    // The box test covers the error from the ray's origin. The padding covers the other errors,
    // which grow with the coordinates of the instance: those of its box, and the translation that
    // the transform subtracts.
    constexpr double unit_error = 0x1p-22;
    const double pad = unit_error * static_cast<double>(error) * size;
    constexpr float infinity = std::numeric_limits<float>::infinity();
    // In a nearly singular placement the error may exceed the whole range of coordinates.
    const auto inside = [](float padded, double side) {
        const auto room = static_cast<float>(std::max(std::abs(side), double{coordinate_max}));
        return std::clamp(padded, -room, room);
    };
    Box box;
    for (int axis = 0; axis < 3; ++axis) {
        const auto least = static_cast<float>(lower[axis] - pad);
        const auto most = static_cast<float>(upper[axis] + pad);
        box.lower[axis] = inside(std::nextafter(least, -infinity), lower[axis]);
        box.upper[axis] = inside(std::nextafter(most, infinity), upper[axis]);
    }
    return {box, pad};
}

Box scene_bounds(const Content& content) {
    const auto root = static_cast<std::uint32_t>(content.objects.size() - 1);
    Box box;
    if (content.trees[root].bounds.is_empty()) return box;
    tbb::parallel_for(0, 6, [&](int side) {
        const int axis = side / 2;
        const double sign = side % 2 == 0 ? -1 : 1;
        Direction direction{};
        direction[static_cast<std::size_t>(axis)] = sign;
        const Farthest farthest(content, root, direction, Farthest::Aim::exact);
        // + 0: without -0
        const float place = static_cast<float>(sign * farthest.distance()) + 0.0F;
        (sign < 0 ? box.lower : box.upper)[axis] = place;
    });
    return box;
}

}  // namespace raynest
