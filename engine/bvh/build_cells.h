// The upper levels of a large tree, over cells of a grid instead of single items.
//
// Ganestam et al., "Bonsai: rapid bounding volume hierarchy generation using mini trees" (2015):
// items are sorted into cells by their centres, and the surface area heuristic splits the list of
// cells, each with the box and the number of its items. Two passes over all items replace one for
// each upper level. Ours leaves the cells again while a range still holds several of them: where
// few planes between cells are left, the items themselves are split.
#pragma once

#include "engine/bvh/build_loops.h"

#include <cstdint>

namespace raynest::build {

/// From so many items on cells pay.
inline constexpr std::uint32_t cells_from = 1U << 16;

class CellTree {
public:
    /// Sorts the items by the order of the tree's cells.
    CellTree(PageVector<Item>& items, std::uint32_t count, const Extent& centers,
             std::uint32_t block_items, const Loops& loops);

    /// A range of cells. If `cut` is 0, it is not split any more; else the right part begins at
    /// this cell.
    struct Cells {
        std::uint32_t first, count, cut;
    };
    [[nodiscard]] Cells root() const { return root_; }
    [[nodiscard]] Cells left_of(const Cells& cells) const;
    [[nodiscard]] Cells right_of(const Cells& cells) const;
    [[nodiscard]] Range items_of(const Cells& cells) const;

private:
    struct Cuts {
        std::uint32_t left, right;
    };
    std::uint32_t split(std::uint32_t first, std::uint32_t count, const Extent& centers,
                        std::uint32_t depth);

    std::uint32_t block_items_;
    const Loops& loops_;
    PageVector<Item> cells_;                ///< boxes of the cells that hold items
    PageVector<std::uint32_t> sizes_;       ///< items of a cell, by its number in the item's id
    PageVector<std::uint32_t> first_item_;  ///< of each cell in the order of the tree
    PageVector<Cuts> cuts_;                 ///< of the halves of a range that is split, by its cut
    Cells root_{};
};

}  // namespace raynest::build
