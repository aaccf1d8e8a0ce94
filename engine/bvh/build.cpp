// Binned SAH to a binary tree, then the cheapest cut of it into 8-wide nodes.
//
// The collapse is the dynamic program of Ylitie, Karras, Laine, "Efficient incoherent ray traversal
// on GPUs through compressed wide BVHs" (2017): for every binary node the least cost of
// representing its subtree by 1..8 roots. Two passes of linear time; the expensive part is the
// binning.
#include "engine/bvh/build.h"

#include "engine/geometry/hit.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstddef>

namespace raynest {
namespace {

// Costs relative to one node visit; measured on the prototype of the traversal notes.
constexpr float node_cost = 1.0F;
constexpr float block_cost = 0.8F;
constexpr float record_cost = 0.4F;
constexpr float instance_cost = 4.0F;
constexpr int bin_count = 16;
constexpr std::uint32_t binary_leaf_items = 2;
constexpr std::uint32_t leaf_items_max = 8;

struct Item {
    Box box;
    std::uint32_t id;
    ChildKind kind;
};

struct BinaryNode {
    Box box;
    std::uint32_t first, count;  // items below
    std::uint32_t left, right;   // no_id in a leaf
    bool one_kind;               // all items below are of the kind of the first
};

// Least cost of a subtree as at most 1..8 roots (index 0..7), and how the minimum is reached.
struct Cut {
    std::array<float, 8> cost;
    std::array<std::uint8_t, 8> left_roots;  // how many of the roots the left child gets
    std::uint8_t single;                     // bit i: of i+1 roots, one root is still the cheapest
    bool leaf;                               // that one root is a leaf
};

class Builder {
public:
    explicit Builder(const TreeInput& input) : input_(input) { gather(); }

    Tree build() {
        if (items_.empty()) return {};
        split_all();
        plan_cuts();
        tree_.bounds = binary_[0].box;
        tree_.root = emit(0, 1);
        tree_.sah_cost = static_cast<double>(cuts_[0].cost[0]) /
                         std::max(static_cast<double>(binary_[0].box.half_area()), 1e-30);
        return std::move(tree_);
    }

private:
    void gather() {
        items_.reserve(input_.boxes.size());
        for (std::uint32_t i = 0; i < input_.boxes.size(); ++i) {
            const Box& box = input_.boxes[i];
            const Vec3 size = box.upper - box.lower;
            if (box.is_empty() || !std::isfinite(size.x + size.y + size.z)) continue;
            const ChildKind kind = i < input_.triangle_count ? ChildKind::triangles
                                   : i < input_.triangle_count + input_.record_count
                                       ? ChildKind::records
                                       : ChildKind::instance;
            items_.push_back({box, i, kind});
        }
    }

    // Splits until leaves are small; iterative, so that no input can exhaust the stack.
    void split_all() {
        binary_.reserve(2 * items_.size());
        binary_.push_back(make_node(0, static_cast<std::uint32_t>(items_.size())));
        struct Task {
            std::uint32_t node, depth;
        };
        std::vector<Task> tasks{{0, 1}};
        while (!tasks.empty()) {
            const Task task = tasks.back();
            tasks.pop_back();
            const std::uint32_t first = binary_[task.node].first;
            const std::uint32_t count = binary_[task.node].count;
            const bool may_stop = binary_[task.node].one_kind && count <= binary_leaf_items &&
                                  items_[first].kind != ChildKind::instance;
            if (count == 1 || may_stop) continue;
            // Halving from here on reaches single items below tree_height_max: the bound on the
            // traversal stack rests on it.
            const auto levels_to_go = static_cast<std::uint32_t>(std::bit_width(count - 1));
            const bool must_halve = task.depth + levels_to_go >= tree_height_max - 1;
            const std::uint32_t left_count =
                must_halve ? halve(first, count) : split_by_sah(first, count);
            const auto left = static_cast<std::uint32_t>(binary_.size());
            binary_.push_back(make_node(first, left_count));
            binary_.push_back(make_node(first + left_count, count - left_count));
            binary_[task.node].left = left;
            binary_[task.node].right = left + 1;
            tasks.push_back({left + 1, task.depth + 1});
            tasks.push_back({left, task.depth + 1});
        }
    }

    BinaryNode make_node(std::uint32_t first, std::uint32_t count) const {
        BinaryNode node{{}, first, count, no_id, no_id, true};
        for (std::uint32_t i = first; i < first + count; ++i) {
            node.box.extend(items_[i].box);
            node.one_kind = node.one_kind && items_[i].kind == items_[first].kind;
        }
        return node;
    }

    static Vec3 doubled_center(const Item& item) { return item.box.lower + item.box.upper; }

    // Equal halves along the widest axis of the centres; by index where all centres coincide.
    std::uint32_t halve(std::uint32_t first, std::uint32_t count) {
        Box centers;
        for (std::uint32_t i = first; i < first + count; ++i) {
            centers.extend(doubled_center(items_[i]));
        }
        const Vec3 size = centers.size();
        const int axis = size.x >= size.y && size.x >= size.z ? 0 : size.y >= size.z ? 1 : 2;
        const auto begin = items_.begin() + first;
        std::nth_element(begin, begin + count / 2, begin + count,
                         [axis](const Item& a, const Item& b) {
                             const float ca = doubled_center(a)[axis];
                             const float cb = doubled_center(b)[axis];
                             return ca != cb ? ca < cb : a.id < b.id;
                         });
        return count / 2;
    }

    std::uint32_t split_by_sah(std::uint32_t first, std::uint32_t count) {
        Box centers;
        for (std::uint32_t i = first; i < first + count; ++i) {
            centers.extend(doubled_center(items_[i]));
        }
        const Vec3 size = centers.size();
        // 0.999: the largest centre stays inside the last bin.
        Vec3 scale{0.0F};
        for (int axis = 0; axis < 3; ++axis) {
            if (size[axis] > 0) scale[axis] = 0.999F * bin_count / size[axis];
            if (!std::isfinite(scale[axis])) scale[axis] = 0;
        }
        const auto bin_of = [&](const Item& item, int axis) {
            const float at = (doubled_center(item)[axis] - centers.lower[axis]) * scale[axis];
            return std::clamp(static_cast<int>(at), 0, bin_count - 1);
        };

        struct Bin {
            Box box;
            std::uint32_t count = 0;
        };
        std::array<std::array<Bin, bin_count>, 3> bins;
        for (std::uint32_t i = first; i < first + count; ++i) {
            for (std::size_t axis = 0; axis < 3; ++axis) {
                Bin& bin =
                    bins[axis][static_cast<std::size_t>(bin_of(items_[i], static_cast<int>(axis)))];
                bin.box.extend(items_[i].box);
                ++bin.count;
            }
        }

        float best_cost = std::numeric_limits<float>::infinity();
        int best_axis = -1;
        int best_bin = 0;
        for (int axis = 0; axis < 3; ++axis) {
            if (scale[axis] == 0) continue;
            const auto& row = bins[static_cast<std::size_t>(axis)];
            std::array<float, bin_count> right_cost{};
            Box box;
            std::uint32_t right = 0;
            for (std::size_t b = bin_count - 1; b > 0; --b) {
                box.extend(row[b].box);
                right += row[b].count;
                right_cost[b] = box.half_area() * static_cast<float>(right);
            }
            box = {};
            std::uint32_t left = 0;
            for (std::size_t b = 0; b + 1 < bin_count; ++b) {
                box.extend(row[b].box);
                left += row[b].count;
                if (left == 0 || left == count) continue;
                const float cost = box.half_area() * static_cast<float>(left) + right_cost[b + 1];
                if (cost < best_cost) {
                    best_cost = cost;
                    best_axis = axis;
                    best_bin = static_cast<int>(b);
                }
            }
        }
        if (best_axis < 0)
            return halve(first, count);  // coincident centres, or areas that overflow
        const auto begin = items_.begin() + first;
        const auto middle = std::partition(begin, begin + count, [&](const Item& item) {
            return bin_of(item, best_axis) <= best_bin;
        });
        return static_cast<std::uint32_t>(middle - begin);
    }

    float leaf_cost(const BinaryNode& node) const {
        if (!node.one_kind) return std::numeric_limits<float>::infinity();
        const float area = node.box.half_area();
        switch (items_[node.first].kind) {
            case ChildKind::triangles:
                if (node.count <= leaf_items_max) return area * block_cost;
                break;
            case ChildKind::records:
                if (node.count <= leaf_items_max) {
                    return area * record_cost * static_cast<float>(node.count);
                }
                break;
            case ChildKind::instance:
                if (node.count == 1) return area * instance_cost;
                break;
        }
        return std::numeric_limits<float>::infinity();
    }

    void plan_cuts() {
        cuts_.resize(binary_.size());
        for (std::size_t n = binary_.size(); n-- > 0;) {  // children come after their parent
            const BinaryNode& node = binary_[n];
            Cut& cut = cuts_[n];
            cut.left_roots.fill(1);
            if (node.left == no_id) {
                cut.cost.fill(leaf_cost(node));
                cut.single = 0xFF;
                cut.leaf = true;
                continue;
            }
            const Cut& left = cuts_[node.left];
            const Cut& right = cuts_[node.right];
            for (std::size_t roots = 2; roots <= 8; ++roots) {
                float best = std::numeric_limits<float>::infinity();
                std::uint8_t best_left = 1;
                for (std::size_t k = 1; k < roots; ++k) {
                    const float cost = left.cost[k - 1] + right.cost[roots - k - 1];
                    if (cost < best) {
                        best = cost;
                        best_left = static_cast<std::uint8_t>(k);
                    }
                }
                cut.cost[roots - 1] = best;
                cut.left_roots[roots - 1] = best_left;
            }
            const float as_leaf = leaf_cost(node);
            const float as_node = cut.cost[7] + node.box.half_area() * node_cost;
            cut.leaf = as_leaf <= as_node && as_leaf < std::numeric_limits<float>::infinity();
            cut.cost[0] = cut.leaf ? as_leaf : as_node;
            cut.single = 1;
            for (std::size_t roots = 2; roots <= 8; ++roots) {
                if (cut.cost[0] > cut.cost[roots - 1]) continue;
                cut.cost[roots - 1] = cut.cost[0];
                cut.single = static_cast<std::uint8_t>(cut.single | 1U << (roots - 1));
            }
        }
    }

    // Binary nodes that stand for `node` when it may have `roots` roots.
    void collect(std::uint32_t node, std::uint32_t roots, std::array<std::uint32_t, 8>& out,
                 std::uint32_t& count) const {
        const Cut& cut = cuts_[node];
        if ((cut.single >> (roots - 1) & 1U) != 0) {
            out[count++] = node;
            return;
        }
        const std::uint32_t from_left = cut.left_roots[roots - 1];
        collect(binary_[node].left, from_left, out, count);
        collect(binary_[node].right, roots - from_left, out, count);
    }

    // Depth first, a node before its children: indices only grow downwards. Recursion is bounded by
    // tree_height_max.
    std::uint32_t emit(std::uint32_t index, std::uint32_t height) {
        const BinaryNode& node = binary_[index];
        if (cuts_[index].leaf) return emit_leaf(node);
        tree_.height = std::max(tree_.height, height);

        std::array<std::uint32_t, 8> roots{};
        std::uint32_t count = 0;
        const std::uint32_t from_left = cuts_[index].left_roots[7];
        collect(node.left, from_left, roots, count);
        collect(node.right, 8 - from_left, roots, count);

        const auto at = static_cast<std::uint32_t>(tree_.nodes.size());
        tree_.nodes.emplace_back();
        fill_boxes(tree_.nodes[at], roots, count);
        for (std::uint32_t slot = 0; slot < count; ++slot) {
            const std::uint32_t child = emit(roots[slot], height + 1);
            tree_.nodes[at].child[slot] = child;
        }
        return at;
    }

    void fill_boxes(Node& out, const std::array<std::uint32_t, 8>& roots,
                    std::uint32_t count) const {
        std::array<Vec3, 8> centers{};
        for (std::uint32_t slot = 0; slot < 8; ++slot) {
            const Box box = slot < count ? binary_[roots[slot]].box : Box{};
            for (int axis = 0; axis < 3; ++axis) {
                out.lower[axis][slot] = box.lower[axis];
                out.upper[axis][slot] = box.upper[axis];
            }
            out.child[slot] = child_empty;
            centers[slot] = box.center();
        }
        std::fill(std::begin(out.order), std::end(out.order), 0);
        for (std::uint32_t octant = 0; octant < 8; ++octant) {
            const Vec3 diagonal{(octant & 1U) != 0 ? -1.0F : 1.0F,
                                (octant & 2U) != 0 ? -1.0F : 1.0F,
                                (octant & 4U) != 0 ? -1.0F : 1.0F};
            std::array<std::uint32_t, 8> slots{0, 1, 2, 3, 4, 5, 6, 7};
            std::stable_sort(
                slots.begin(), slots.begin() + count, [&](std::uint32_t a, std::uint32_t b) {
                    return glm::dot(centers[a], diagonal) < glm::dot(centers[b], diagonal);
                });
            for (std::size_t i = 0; i < 8; ++i) out.order[i] |= slots[i] << (3 * octant);
        }
        out.order[0] |= ((1U << count) - 1) << 24;
    }

    std::uint32_t emit_leaf(const BinaryNode& node) {
        const ChildKind kind = items_[node.first].kind;
        std::array<std::uint32_t, leaf_items_max> ids{};
        const std::uint32_t count = std::min(node.count, leaf_items_max);
        for (std::uint32_t i = 0; i < count; ++i) ids[i] = items_[node.first + i].id;
        std::stable_sort(ids.begin(), ids.begin() + count);
        if (kind == ChildKind::instance) {
            return make_instance_leaf(ids[0] - input_.triangle_count - input_.record_count);
        }
        if (kind == ChildKind::records) {
            const auto first = static_cast<std::uint32_t>(tree_.record_order.size());
            for (std::uint32_t i = 0; i < count; ++i) {
                tree_.record_order.push_back(ids[i] - input_.triangle_count);
            }
            return make_leaf(kind, first, count);
        }
        const auto block = static_cast<std::uint32_t>(tree_.block_lanes.size() / 8);
        for (std::uint32_t lane = 0; lane < 8; ++lane) {
            tree_.block_lanes.push_back(lane < count ? ids[lane] : no_id);
        }
        return make_leaf(kind, block, 1);
    }

    const TreeInput& input_;
    std::vector<Item> items_;
    std::vector<BinaryNode> binary_;
    std::vector<Cut> cuts_;
    Tree tree_;
};

}  // namespace

Tree build_tree(const TreeInput& input) {
    return Builder(input).build();
}

}  // namespace raynest
