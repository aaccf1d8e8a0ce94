// The binary tree under the 8-wide one: items are split until few are left, from the root down; on
// the way back every node gets its box and its plan (build_cut.h).
//
// Subtrees that are built at the same time take places for their nodes from one pool, some at once.
// Which place a node gets means nothing: links lead to it, so nothing depends on who was first.
#pragma once

#include "engine/bvh/build.h"
#include "engine/bvh/build_cells.h"
#include "engine/bvh/build_cut.h"
#include "engine/bvh/build_items.h"
#include "engine/bvh/build_loops.h"
#include "engine/bvh/build_morton.h"
#include "engine/bvh/build_split.h"

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <optional>

namespace raynest::build {

/// A child of a binary node: an inner node, or a leaf of `count` items.
class Link {
public:
    static Link inner(std::uint32_t node) { return Link(node); }
    static Link leaf(std::uint32_t count) { return Link(leaf_bit | count); }
    Link() = default;

    [[nodiscard]] bool is_leaf() const { return (word_ & leaf_bit) != 0; }
    [[nodiscard]] std::uint32_t node() const { return word_; }
    [[nodiscard]] std::uint32_t count() const { return word_ & ~leaf_bit; }

private:
    static constexpr std::uint32_t leaf_bit = 1U << 31;
    explicit Link(std::uint32_t word) : word_(word) {}
    std::uint32_t word_ = leaf_bit;
};

struct BinaryNode {
    Box box;
    Link left, right;
    std::uint32_t right_first;  ///< where the items of the right child begin
    Plan plan;
    /// Where it becomes a leaf or an 8-wide node: wide nodes of its subtree (build_emit.h), and
    /// blocks or records of its leaves.
    std::uint32_t wide_nodes, leaf_entries;
};

/// Places for nodes: only as much of the memory is touched as there are nodes.
class NodePool {
public:
    explicit NodePool(std::size_t room) : nodes_(room) {}
    [[nodiscard]] BinaryNode& operator[](std::uint32_t index) { return nodes_[index]; }
    [[nodiscard]] const BinaryNode& operator[](std::uint32_t index) const { return nodes_[index]; }

    /// Places for one thread.
    class Run {
    public:
        /// At most so many nodes will be asked for: never more places are taken.
        Run(NodePool& pool, std::uint32_t most) : pool_(pool), most_(most) {}
        [[nodiscard]] std::uint32_t next() {
            if (at_ == end_) {
                const std::uint32_t count = std::min(most_, places_at_once);
                at_ = pool_.taken_.fetch_add(count, std::memory_order_relaxed);
                end_ = at_ + count;
                most_ -= count;
            }
            return at_++;
        }

    private:
        static constexpr std::uint32_t places_at_once = 64;
        NodePool& pool_;
        std::uint32_t most_, at_ = 0, end_ = 0;
    };

private:
    PageVector<BinaryNode> nodes_;
    std::atomic<std::uint32_t> taken_ = 0;
};

class BinaryTree {
public:
    explicit BinaryTree(const TreeInput& input, const Loops& fastest = loops().back());

    [[nodiscard]] bool is_empty() const { return count_ == 0; }
    /// Splits everything; SAH cost of the root, times its area.
    float build();

    [[nodiscard]] Link root() const { return root_; }
    [[nodiscard]] const Box& box() const { return box_; }
    [[nodiscard]] BinaryNode& node(std::uint32_t index) { return nodes_[index]; }
    [[nodiscard]] const BinaryNode& node(std::uint32_t index) const { return nodes_[index]; }
    [[nodiscard]] const Item* items() const { return items_.data(); }
    [[nodiscard]] const TreeInput& input() const { return input_; }
    /// Leaves may hold an item twice.
    [[nodiscard]] bool splits_triangles() const { return splits_triangles_; }
    [[nodiscard]] ChildKind kind_of_item(std::uint32_t id) const {
        return id < input_.triangle_count                         ? ChildKind::triangles
               : id < input_.triangle_count + input_.record_count ? ChildKind::records
                                                                  : ChildKind::instance;
    }

private:
    struct Subtree {
        Link link;
        Extent box;
        Load load;
        Costs costs;
    };

    /// The sound items of a part of the input.
    struct Part {
        std::uint32_t count = 0;
        Extent centers = Extent::none(), bounds = Extent::none();
    };

    void gather();
    void gather_part(std::size_t first, std::span<Item> out, Part& part) const;
    Subtree build_all();
    Subtree split_cells(const CellTree& tree, const CellTree::Cells& cells, std::uint32_t depth);
    Subtree split_in_tasks(const Range& range, const Extent& centers, std::uint32_t depth);
    Subtree split(const Range& range, const Extent& centers, std::uint32_t depth,
                  NodePool::Run& places);
    Halves halves_of(const Range& range, const Extent& centers, std::uint32_t depth);
    std::optional<Halves> halves_in_space(const Range& range, const ObjectSplit& object);
    [[nodiscard]] std::uint32_t block_items() const { return triangles_only_ ? 8 : 1; }
    [[nodiscard]] bool may_be_leaf(const Range& range) const;
    [[nodiscard]] Subtree leaf(const Range& range) const;
    Subtree join(std::uint32_t index, std::uint32_t right_first, const Subtree& left,
                 const Subtree& right);

    const TreeInput& input_;
    const Loops& loops_;
    bool triangles_only_;
    bool splits_triangles_;
    std::uint32_t count_ = 0;
    Extent centers_ = Extent::none();
    std::size_t room_;  ///< places for items
    PageVector<Item> items_;
    NodePool nodes_;
    std::optional<MortonOrder> order_;  ///< set for a fast build
    float overlap_min_ = 0;
    Link root_;
    Box box_;
};

}  // namespace raynest::build
