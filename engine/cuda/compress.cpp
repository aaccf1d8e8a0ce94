#include "engine/cuda/compress.h"

#include "engine/cuda/limits.h"
#include "engine/geometry/intersect_triangle.h"
#include "engine/math/mask.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <string>

namespace raynest::cuda {
namespace {

constexpr std::uint32_t slots = 8;
constexpr std::uint32_t steps = 255;  // planes of the grid, less one
constexpr int mantissa_shift = 15;    // grid_value() scales a byte by 2^-15
constexpr std::uint32_t exponent_max = 254;

// The grid of one axis, over [low, high].
struct Grid {
    float origin = std::numeric_limits<float>::quiet_NaN();
    std::uint32_t exponent = 1;

    Grid(float low, float high) {
        if (!(std::abs(low) < std::numeric_limits<float>::infinity()) ||
            !(std::abs(high) < std::numeric_limits<float>::infinity())) {
            return;
        }
        // Compute in double, where neither the difference nor the quotient overflows; the loop
        // below corrects the result.
        const double step = (double{high} - double{low}) / steps;
        const int power = step > 0 ? std::ilogb(step) + mantissa_shift : -126;
        const int first = std::clamp(power, -126, 127) + 127;
        for (exponent = static_cast<std::uint32_t>(first); exponent <= exponent_max; ++exponent) {
            origin = low - std::bit_cast<float>(exponent << 23);
            if (plane(0) > low) origin = std::nextafter(origin, -std::numeric_limits<float>::max());
            if (plane(0) <= low && plane(steps) >= high) return;
        }
        *this = Grid(std::numeric_limits<float>::infinity(), 0);
    }

    [[nodiscard]] float plane(std::uint32_t byte) const {
        return grid_plane(origin, exponent, grid_value(byte, 0));
    }
    // Returns the last plane that is not above `value`, which lies in the grid's range; 0 without a
    // grid.
    [[nodiscard]] std::uint32_t below(float value) const {
        std::uint32_t byte = guess(value);
        while (byte > 0 && plane(byte) > value) --byte;
        while (byte < steps && plane(byte + 1) <= value) ++byte;
        return byte;
    }
    [[nodiscard]] std::uint32_t above(float value) const {
        std::uint32_t byte = guess(value);
        while (byte < steps && plane(byte) < value) ++byte;
        while (byte > 0 && plane(byte - 1) >= value) --byte;
        return byte;
    }

private:
    [[nodiscard]] std::uint32_t guess(float value) const {
        const float step = std::ldexp(1.0F, static_cast<int>(exponent) - 127 - mantissa_shift);
        const float at = (value - plane(0)) / step;
        return at > 0 ? static_cast<std::uint32_t>(std::min(at, float{steps})) : 0;
    }
};

// Assigns children to slots; the child that gains most from its best slot comes first.
std::array<std::uint32_t, slots> arrange(const Node& node) {
    std::array<Vec3, slots> from_middle{};
    Vec3 middle(0);
    const std::uint32_t valid = node.valid();
    for_each_lane<8>(valid, [&](int c) {
        for (int axis = 0; axis < 3; ++axis) {
            from_middle[static_cast<std::size_t>(c)][axis] =
                0.5F * node.lower[axis][c] + 0.5F * node.upper[axis][c];
        }
        middle +=
            from_middle[static_cast<std::size_t>(c)] / static_cast<float>(std::popcount(valid));
    });
    for (Vec3& center : from_middle) center -= middle;

    std::array<std::uint32_t, slots> child_in{};
    child_in.fill(child_empty);
    for (std::uint32_t children = valid; children != 0;) {
        float best = -std::numeric_limits<float>::infinity();
        std::uint32_t best_child = lowest_bit(children);
        std::uint32_t best_slot = static_cast<std::uint32_t>(
            std::find(child_in.begin(), child_in.end(), child_empty) - child_in.begin());
        for_each_lane<8>(children, [&](int c) {
            const Vec3& d = from_middle[static_cast<std::size_t>(c)];
            for (std::uint32_t slot = 0; slot < slots; ++slot) {
                if (child_in[slot] != child_empty) continue;
                const float fit = ((slot & 1U) != 0 ? d.x : -d.x) +
                                  ((slot & 2U) != 0 ? d.y : -d.y) + ((slot & 4U) != 0 ? d.z : -d.z);
                if (fit <= best) continue;
                best = fit;
                best_child = static_cast<std::uint32_t>(c);
                best_slot = slot;
            }
        });
        child_in[best_slot] = best_child;
        children &= ~(1U << best_child);
    }
    return child_in;
}

void set_byte(std::uint32_t (&words)[2], std::uint32_t slot, std::uint32_t byte) {
    words[slot >> 2] |= byte << (8 * (slot & 3U));
}

void copy_block(const TriangleBlock& block, DeviceTriangle* to) {
    for (int lane = 0; lane < 8; ++lane) {
        if (block.triangle[lane] == no_id) continue;
        const TriangleRef triangle(block, lane);
        *to++ = {triangle.v0, triangle.prim, triangle.v1, 0, triangle.v2, 0};
    }
}

// Counts the stack entries that a ray may need at once: entering a node needs one for its waiting
// siblings; entering an instance needs one more for the mark. A leaf's primitives are tested at
// once.
class StackNeed {
public:
    explicit StackNeed(const SceneView& scene) : scene_(scene), of_object_(scene.object_count) {}

    // Objects are listed before those that place them, and parents before their children.
    std::uint32_t of_root() {
        for (std::uint32_t o = 0; o < scene_.object_count; ++o) {
            const ObjectRecord& object = scene_.objects[o];
            of_node_.assign(object.node_count, 0);
            for (std::uint32_t n = object.node_count; n-- > 0;) {
                const Node& node = scene_.nodes[object.first_node + n];
                const std::uint32_t siblings = std::popcount(node.valid()) > 1 ? 1 : 0;
                for_each_lane<8>(node.valid(), [&](int slot) {
                    of_node_[n] =
                        std::max(of_node_[n], of_child(object, node.child[slot], siblings));
                });
            }
            of_object_[o] = of_child(object, object.root, 0);
        }
        return of_object_[scene_.root];
    }

private:
    [[nodiscard]] std::uint32_t of_child(const ObjectRecord& object, std::uint32_t child,
                                         std::uint32_t siblings) const {
        if (child == child_empty) return 0;
        if (!is_leaf(child)) return siblings + of_node_[child];
        if (kind_of(child) != ChildKind::instance) return 0;
        const std::uint32_t instance = object.first_instance + leaf_instance(child);
        return siblings + 1 + of_object_[scene_.instances[instance].object];
    }

    const SceneView& scene_;
    std::vector<std::uint32_t> of_object_;
    std::vector<std::uint32_t> of_node_;  ///< by node of the current object
};

Result<void> check_limits(const SceneView& scene) {
    const std::uint32_t levels = scene.objects[scene.root].levels;
    if (levels > levels_max) {
        return fail(ErrorCode::limit_exceeded, "the scene has " + std::to_string(levels) +
                                                   " levels, the GPU supports " +
                                                   std::to_string(levels_max) + ": use the CPU");
    }
    const std::uint32_t need = StackNeed(scene).of_root();
    if (need > CompressedTrees::stack_max) {
        return fail(ErrorCode::limit_exceeded,
                    "a ray may need " + std::to_string(need) + " entries of stack, the GPU has " +
                        std::to_string(CompressedTrees::stack_max) + ": use the CPU");
    }
    return {};
}

}  // namespace

CompressedNode compress(const Node& node) {
    CompressedNode to{};
    const std::array<std::uint32_t, slots> child_in = arrange(node);
    for (std::uint32_t slot = 0; slot < slots; ++slot) {
        const std::uint32_t c = child_in[slot];
        to.child[slot] = c == child_empty ? child_empty : node.child[c];
        if (c != child_empty) to.boxes.valid |= static_cast<std::uint8_t>(1U << slot);
    }
    for (std::size_t axis = 0; axis < 3; ++axis) {
        float low = std::numeric_limits<float>::infinity();
        float high = -low;
        for (const std::uint32_t c : child_in) {
            if (c == child_empty) continue;
            low = std::min(low, node.lower[axis][c]);
            high = std::max(high, node.upper[axis][c]);
        }
        const Grid grid(low, high);
        to.boxes.origin[axis] = grid.origin;
        to.boxes.exponent[axis] = static_cast<std::uint8_t>(grid.exponent);
        for (std::uint32_t slot = 0; slot < slots; ++slot) {
            const std::uint32_t c = child_in[slot];
            if (c == child_empty) continue;
            set_byte(to.boxes.lower[axis], slot, grid.below(node.lower[axis][c]));
            set_byte(to.boxes.upper[axis], slot, grid.above(node.upper[axis][c]));
        }
    }
    return to;
}

std::vector<CompressedNode> compress(std::span<const Node> nodes) {
    std::vector<CompressedNode> to;
    to.reserve(nodes.size());
    for (const Node& node : nodes) to.push_back(compress(node));
    return to;
}

std::vector<DeviceTriangle> compress(std::span<const TriangleBlock> blocks) {
    constexpr DeviceTriangle padding{{}, no_id, {}, 0, {}, 0};
    std::vector<DeviceTriangle> to(8 * blocks.size(), padding);
    for (std::size_t b = 0; b < blocks.size(); ++b) copy_block(blocks[b], to.data() + 8 * b);
    return to;
}

Result<DeviceTrees> compress(const SceneView& scene) {
    if (const auto sound = check_limits(scene); !sound) return tl::unexpected(sound.error());
    DeviceTrees trees;
    std::uint64_t node_count = 0;
    std::uint64_t block_count = 0;
    for (std::uint32_t o = 0; o < scene.object_count; ++o) {
        node_count += scene.objects[o].node_count;
        block_count += scene.objects[o].block_count;
    }
    trees.nodes = compress(std::span(scene.nodes, node_count));
    trees.triangles = compress(std::span(scene.blocks, block_count));
    return trees;
}

}  // namespace raynest::cuda
