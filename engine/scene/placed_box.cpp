#include "engine/scene/placed_box.h"

#include "engine/scene/snapshot.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <utility>

namespace raynest {
namespace {

// In double precision: products of floats are exact, their sums good to far less than a float.
using Direction = std::array<double, 3>;

/// How far boxes reach along a direction: the upper side counts where it points up.
class Reach {
public:
    explicit Reach(const Direction& direction) : direction_(direction) {}

    [[nodiscard]] double of(const Box& box) const {
        double sum = 0;
        for (int axis = 0; axis < 3; ++axis) {
            const float side = points_up(axis) ? box.upper[axis] : box.lower[axis];
            sum += along(axis) * static_cast<double>(side);
        }
        return sum;
    }

    /// Of all eight children; of empty slots it is meaningless.
    [[nodiscard]] std::array<double, 8> of(const Node& node) const {
        std::array<double, 8> sums{};
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

    const Direction direction_;
};

/// How far the leaves of a tree reach along a direction, or an upper bound of it: the farthest
/// child first, and no child that the leaves met so far have passed.
///
/// A few nodes are enough; where they are not, many leaves reach nearly as far, and it matters
/// little which of them is taken. Measured on the forests of tests/bench: rays through nested
/// instances are 1.13 times as fast as with turned boxes, one level 1.08 times; with 64 nodes no
/// faster.
class Farthest {
public:
    Farthest(const Tree& tree, const Direction& direction) : tree_(tree), reach_(direction) {
        visit(tree.root, reach_.of(tree.bounds));
    }
    [[nodiscard]] double distance() const { return farthest_; }

private:
    void visit(std::uint32_t child, double distance) {
        if (is_leaf(child) || opened_ == opened_max) {
            farthest_ = std::max(farthest_, distance);
            return;
        }
        ++opened_;
        const Node& node = tree_.nodes[child];
        std::array<double, 8> distances = reach_.of(node);
        for (std::size_t slot = 0; slot < 8; ++slot) {
            if ((node.valid() >> slot & 1U) == 0) distances[slot] = nothing;
        }
        for (;;) {
            const auto next = std::max_element(distances.begin(), distances.end());
            if (*next <= farthest_) return;
            visit(node.child[next - distances.begin()], std::exchange(*next, nothing));
        }
    }

    static constexpr int opened_max = 8;
    static constexpr double nothing = -std::numeric_limits<double>::infinity();
    const Tree& tree_;
    const Reach reach_;
    double farthest_ = nothing;
    int opened_ = 0;
};

}  // namespace

Box placed_box(const Tree& child, const Transform& to_parent, float error) {
    if (child.bounds.is_empty()) return {};
    double lower[3], upper[3];
    double size = 0;  // the largest coordinate involved
    for (std::size_t row = 0; row < 3; ++row) {
        const float* m = &to_parent.m[4 * row];
        const Direction axis{m[0], m[1], m[2]};
        const Direction back{-axis[0], -axis[1], -axis[2]};
        const auto moved = static_cast<double>(m[3]);
        upper[row] = moved + Farthest(child, axis).distance();
        lower[row] = moved - Farthest(child, back).distance();
        size = std::max({size, std::abs(moved), std::abs(moved + Reach(axis).of(child.bounds)),
                         std::abs(moved - Reach(back).of(child.bounds))});
    }

    // The box test covers the error that comes from the ray's origin. The padding covers the rest,
    // which grows with the coordinates of the instance itself: its box, and the translation that
    // the transform subtracts again.
    constexpr double unit_error = 0x1p-22;
    const double pad = unit_error * static_cast<double>(error) * size;
    constexpr float infinity = std::numeric_limits<float>::infinity();
    // Through a nearly singular placement the error may exceed all the room that a scene has.
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
    return box;
}

}  // namespace raynest
