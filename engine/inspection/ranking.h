// The rows of a Blame in order: most work first.
#pragma once

#include "engine/inspection/blame.h"

#include <cstdint>
#include <vector>

namespace raynest {

struct RankedRow {
    BlameKey key;
    BlamedWork work;
    /// The work that the row is ranked by: boxes and primitives; of a material, primitives.
    std::uint64_t ranked = 0;
};

struct Ranking {
    std::vector<RankedRow> rows;  ///< all of them
    std::uint64_t total = 0;      ///< boxes and primitives of all rays
    std::uint64_t remainder = 0;  ///< the part that belongs to no row
};

/// Ranks instances; or meshes, which are objects with primitives; or materials. Rows and remainder
/// add up to the total.
[[nodiscard]] Ranking rank(const Blame& blame, BlameTable table);
/// Ranks meshes and objects without primitives.
[[nodiscard]] Ranking rank_all_objects(const Blame& blame);

}  // namespace raynest
