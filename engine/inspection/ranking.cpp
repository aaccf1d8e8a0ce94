#include "engine/inspection/ranking.h"

#include <algorithm>
#include <tuple>

namespace raynest {
namespace {

/// `is_row(key)` chooses rows of a table.
template <class IsRow>
Ranking rank_rows(const Blame& blame, BlameTable table, IsRow&& is_row) {
    Ranking ranking;
    ranking.total = ranking.remainder = blame.total().work();
    for (const auto& [key, work] : blame.rows(table)) {
        if (!is_row(key)) continue;
        const std::uint64_t ranked = table == BlameTable::materials ? work.prims : work.work();
        ranking.rows.push_back({key, work, ranked});
        ranking.remainder -= ranked;
    }
    const auto place = [](const RankedRow& row) {
        return std::tuple(~row.ranked, row.key.placements.first, row.key.depth, row.key.index);
    };
    std::ranges::sort(ranking.rows, {}, place);
    return ranking;
}

}  // namespace

Ranking rank(const Blame& blame, BlameTable table) {
    const SceneView& view = blame.scene().view();
    return rank_rows(blame, table, [&](const BlameKey& key) {
        return table != BlameTable::meshes || view.objects[key.index].has_own_primitives();
    });
}

Ranking rank_all_objects(const Blame& blame) {
    return rank_rows(blame, BlameTable::meshes, [](const BlameKey&) { return true; });
}

}  // namespace raynest
