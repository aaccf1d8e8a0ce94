#include "engine/bvh/build_emit.h"

#include "engine/geometry/hit.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cstddef>

namespace raynest::build {
namespace {

/// Wide levels whose children are shared out as tasks.
constexpr std::uint32_t task_levels = 4;

/// A subtree and where its items begin.
struct Root {
    Link link;
    std::uint32_t first;
};

struct Roots {
    std::array<Root, 8> at;
    std::uint32_t count = 0;
};

template <class Body>
void for_each_root(const Roots& roots, std::uint32_t level, const Body& body) {
    if (level <= task_levels) {
        tbb::parallel_for(0U, roots.count, body);
    } else {
        for (std::uint32_t slot = 0; slot < roots.count; ++slot) body(slot);
    }
}

/// The ids of one leaf, ascending. Parts of a triangle that spatial splits made may meet again in
/// one leaf: it is named once.
struct LeafItems {
    std::array<std::uint32_t, leaf_triangles_max> ids;
    std::uint32_t count = 0;
};
static_assert(leaf_triangles_max >= leaf_records_max);

class Emitter {
public:
    Emitter(BinaryTree& binary, Tree& tree) : binary_(binary), tree_(tree) {}

    void run() {
        const Root root{binary_.root(), 0};
        tree_.height = count(root, 1);
        tree_.nodes.resize(nodes_of(root));
        if (binary_.input().triangle_count != 0) {
            tree_.block_lanes.resize(8 * std::size_t{entries_of(root)});
        } else {
            tree_.record_order.resize(entries_of(root));
        }
        tree_.root = write(root, 0, 0, 1);
    }

private:
    [[nodiscard]] bool is_leaf(const Root& root) const {
        return root.link.is_leaf() || binary_.node(root.link.node()).plan.is_leaf();
    }
    [[nodiscard]] Root left_of(const Root& root) const {
        return {binary_.node(root.link.node()).left, root.first};
    }
    [[nodiscard]] Root right_of(const Root& root) const {
        const BinaryNode& node = binary_.node(root.link.node());
        return {node.right, node.right_first};
    }

    /// The roots that stand for a subtree when it may have so many.
    void collect(const Root& root, std::uint32_t roots, Roots& out) const {
        if (root.link.is_leaf() || binary_.node(root.link.node()).plan.is_one_root(roots)) {
            out.at[out.count++] = root;
            return;
        }
        const std::uint32_t left = binary_.node(root.link.node()).plan.left_roots(roots);
        collect(left_of(root), left, out);
        collect(right_of(root), roots - left, out);
    }
    [[nodiscard]] Roots children_of(const Root& root) const {
        Roots out;
        const std::uint32_t left = binary_.node(root.link.node()).plan.left_roots(8);
        collect(left_of(root), left, out);
        collect(right_of(root), 8 - left, out);
        return out;
    }

    void gather(const Root& root, LeafItems& out) const {
        if (!root.link.is_leaf()) {
            gather(left_of(root), out);
            gather(right_of(root), out);
            return;
        }
        const Item* const items = binary_.items() + root.first;
        for (std::uint32_t i = 0; i < root.link.count(); ++i) out.ids[out.count++] = items[i].id();
    }
    [[nodiscard]] LeafItems items_of(const Root& root) const {
        LeafItems items;
        gather(root, items);
        std::sort(items.ids.begin(), items.ids.begin() + items.count);
        const auto end = std::unique(items.ids.begin(), items.ids.begin() + items.count);
        items.count = static_cast<std::uint32_t>(end - items.ids.begin());
        return items;
    }

    [[nodiscard]] std::uint32_t entries_of(const Root& root) const {
        if (!root.link.is_leaf()) return binary_.node(root.link.node()).leaf_entries;
        const ChildKind kind = binary_.kind_of_item(binary_.items()[root.first].id());
        return leaf_entries({only(kind), root.link.count()});
    }
    [[nodiscard]] std::uint32_t nodes_of(const Root& root) const {
        return is_leaf(root) ? 0 : binary_.node(root.link.node()).wide_nodes;
    }

    /// Height of a root; notes the counts of each wide node, and of leaves that held items twice.
    std::uint32_t count(const Root& root, std::uint32_t level) {
        if (is_leaf(root)) {
            if (binary_.splits_triangles() && !root.link.is_leaf()) {
                binary_.node(root.link.node()).leaf_entries =
                    leaf_entries({only(ChildKind::triangles), items_of(root).count});
            }
            return 0;
        }
        const Roots roots = children_of(root);
        std::array<std::uint32_t, 8> heights{};
        for_each_root(roots, level, [&](std::uint32_t slot) {
            heights[slot] = count(roots.at[slot], level + 1);
        });
        BinaryNode& node = binary_.node(root.link.node());
        node.wide_nodes = 1;
        for (std::uint32_t slot = 0; slot < roots.count; ++slot) {
            node.wide_nodes += nodes_of(roots.at[slot]);
            node.leaf_entries += entries_of(roots.at[slot]);
        }
        return 1 + *std::max_element(heights.begin(), heights.end());
    }

    /// Writes a root at its place; its child word.
    std::uint32_t write(const Root& root, std::uint32_t node_at, std::uint32_t entry_at,
                        std::uint32_t level) {
        if (is_leaf(root)) return write_leaf(items_of(root), entry_at, entries_of(root));
        const Roots roots = children_of(root);
        Node& node = tree_.nodes[node_at];
        fill_boxes(node, roots);

        struct Place {
            std::uint32_t node, entry;
        };
        std::array<Place, 8> places;
        Place next{node_at + 1, entry_at};
        for (std::uint32_t slot = 0; slot < roots.count; ++slot) {
            places[slot] = next;
            next.node += nodes_of(roots.at[slot]);
            next.entry += entries_of(roots.at[slot]);
        }
        for_each_root(roots, level, [&](std::uint32_t slot) {
            node.child[slot] =
                write(roots.at[slot], places[slot].node, places[slot].entry, level + 1);
        });
        return node_at;
    }

    [[nodiscard]] Box box_of(const Root& root) const {
        if (!root.link.is_leaf()) return binary_.node(root.link.node()).box;
        Extent box = Extent::none();
        for (std::uint32_t i = 0; i < root.link.count(); ++i) {
            box.extend(binary_.items()[root.first + i].extent);
        }
        return box.box();
    }

    void fill_boxes(Node& out, const Roots& roots) const {
        for (std::uint32_t slot = 0; slot < 8; ++slot) {
            const Box box = slot < roots.count ? box_of(roots.at[slot]) : Box{};
            for (int axis = 0; axis < 3; ++axis) {
                out.lower[axis][slot] = box.lower[axis];
                out.upper[axis][slot] = box.upper[axis];
            }
            out.child[slot] = child_empty;
        }
        order_children(out, roots.count);
    }

    std::uint32_t write_leaf(const LeafItems& items, std::uint32_t at, std::uint32_t entries) {
        const TreeInput& input = binary_.input();
        const ChildKind kind = binary_.kind_of_item(items.ids[0]);
        if (kind == ChildKind::instance) {
            return make_instance_leaf(items.ids[0] - input.triangle_count - input.record_count);
        }
        if (kind == ChildKind::records) {
            for (std::uint32_t i = 0; i < items.count; ++i) {
                tree_.record_order[at + i] = items.ids[i] - input.triangle_count;
            }
            return make_leaf(kind, at, items.count);
        }
        for (std::uint32_t lane = 0; lane < 8 * entries; ++lane) {
            tree_.block_lanes[8 * std::size_t{at} + lane] =
                lane < items.count ? items.ids[lane] : no_id;
        }
        return make_leaf(kind, at, entries);
    }

    BinaryTree& binary_;
    Tree& tree_;
};

}  // namespace

void order_children(Node& node, std::uint32_t count) {
    float center[3][8];
    for (int axis = 0; axis < 3; ++axis) {
        for (std::uint32_t slot = 0; slot < 8; ++slot)
            center[axis][slot] = 0.5F * node.lower[axis][slot] + 0.5F * node.upper[axis][slot];
    }
    std::ranges::fill(node.order, 0);
    for (std::uint32_t octant = 0; octant < 8; ++octant) {
        float along[8];
        for (std::uint32_t slot = 0; slot < 8; ++slot) {
            const float x = (octant & 1U) != 0 ? -center[0][slot] : center[0][slot];
            const float y = (octant & 2U) != 0 ? -center[1][slot] : center[1][slot];
            const float z = (octant & 4U) != 0 ? -center[2][slot] : center[2][slot];
            along[slot] = slot < count ? x + y + z : std::numeric_limits<float>::infinity();
        }
        std::uint32_t rank[8] = {};
        for (std::uint32_t a = 0; a < 8; ++a) {
            for (std::uint32_t b = 0; b < 8; ++b) {
                // If two slots are equally near, the lower one comes first.
                const bool before = a < b ? along[a] <= along[b] : along[a] < along[b];
                rank[b] += before ? 1 : 0;
            }
        }
        for (std::uint32_t slot = 0; slot < 8; ++slot)
            node.order[rank[slot]] |= slot << (3 * octant);
    }
    node.order[0] |= ((1U << count) - 1) << 24;
}

void emit(BinaryTree& binary, Tree& tree) {
    Emitter(binary, tree).run();
}

}  // namespace raynest::build
