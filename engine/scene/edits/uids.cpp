#include "engine/scene/edits/uids.h"

#include "engine/scene/edits/placed_sums.h"

#include <algorithm>
#include <optional>
#include <utility>

namespace raynest {
namespace {

/// Placements of a node that follow each other and have one user id.
struct UidPart {
    std::uint32_t number;              ///< of the first placement
    std::optional<std::uint32_t> uid;  ///< nothing: the node's
};

/// Says which paths have which id: by the outermost instances, which lie one behind the other.
class Uids {
public:
    Uids(const Snapshot& base, std::span<const InstanceUid> uids)
        : view_(base.view()),
          uids_(uids) {}

    /// Returns the id of a path, and the end of the paths from there on that have the same answer.
    /// Paths must ascend from call to call.
    std::pair<std::optional<std::uint32_t>, std::uint64_t> at(std::uint64_t path) {
        while (!uids_.empty() && end() <= path) uids_ = uids_.subspan(1);
        if (uids_.empty()) return {std::nullopt, ~0ULL};
        if (path < begin()) return {std::nullopt, begin()};
        return {uids_.front().uid, end()};
    }

private:
    [[nodiscard]] const InstanceRecord& instance() const {
        return view_.instances[view_.objects[view_.root].first_instance + uids_.front().outermost];
    }
    [[nodiscard]] std::uint64_t begin() const { return instance().path_base; }
    [[nodiscard]] std::uint64_t end() const {
        return begin() + view_.objects[instance().object].placement_count;
    }

    const SceneView& view_;
    std::span<const InstanceUid> uids_;
};

}  // namespace

std::uint64_t nested_instances(const SceneView& view, std::span<const InstanceUid> uids) {
    const auto sums = placed_sums(view, [](const ObjectRecord&) { return std::uint64_t{1}; });
    const std::uint32_t first = view.objects[view.root].first_instance;
    std::uint64_t nested = 0;
    for (const InstanceUid& change : uids)
        nested = std::min<std::uint64_t>(
            1ULL << 62, nested + sums[view.instances[first + change.outermost].object] - 1);
    return nested;
}

std::vector<InstancePlace> places_within(const SceneView& view, std::uint32_t outermost,
                                         std::uint64_t most) {
    std::vector<InstancePlace> places;
    std::vector<std::uint32_t> way;
    const auto look = [&](const auto& self, std::uint32_t object) -> void {
        const ObjectRecord& record = view.objects[object];
        for (std::uint32_t i = 0; i < record.instance_count && places.size() < most; ++i) {
            way.push_back(i);
            places.emplace_back(outermost, way);
            self(self, view.instances[record.first_instance + i].object);
            way.pop_back();
        }
    };
    look(look, view.instances[view.objects[view.root].first_instance + outermost].object);
    return places;
}

void set_node_uids(const Snapshot& base, std::span<const InstanceUid> uids, Content& content) {
    const std::vector<PathNode> nodes = std::exchange(content.path_nodes, {});
    const std::vector<PathRun> runs = std::exchange(content.path_runs, {});
    std::vector<std::vector<UidPart>> parts(nodes.size());
    Uids wanted(base, uids);
    struct Begin {
        std::uint64_t path;
        std::uint32_t node, part, number;
    };
    std::vector<Begin> begins;
    for (std::size_t r = 0; r < runs.size(); ++r) {
        const PathRun& run = runs[r];
        const std::uint64_t end =
            r + 1 < runs.size() ? runs[r + 1].first_path : base.statistics().instances;
        for (std::uint64_t path = run.first_path; path < end;) {
            const auto [uid, until] = wanted.at(path);
            const auto number = run.number + static_cast<std::uint32_t>(path - run.first_path);
            std::vector<UidPart>& of = parts[run.node];
            if (of.empty() || of.back().uid != uid) of.push_back({number, uid});
            begins.push_back({path, run.node, static_cast<std::uint32_t>(of.size() - 1), number});
            path = std::min(until, end);
        }
    }
    // Further parts of a node stand behind it, as siblings do, and breadth first stays.
    std::vector<std::uint32_t> made(nodes.size());
    for (std::uint32_t i = 0; i < nodes.size(); ++i) {
        made[i] = static_cast<std::uint32_t>(content.path_nodes.size());
        PathNode node = nodes[i];
        node.parent = made[node.parent];
        node.first_run = no_id;
        if (parts[i].empty()) content.path_nodes.push_back(node);
        for (const UidPart& part : parts[i]) {
            PathNode& own = content.path_nodes.emplace_back(node);
            if (&part != &parts[i].front()) own.number = part.number;
            own.source = part.uid.value_or(node.source);
        }
    }
    for (const Begin& begin : begins) {
        const std::uint32_t node = made[begin.node] + begin.part;
        if (content.path_nodes[node].first_run == no_id)
            content.path_nodes[node].first_run =
                static_cast<std::uint32_t>(content.path_runs.size());
        content.path_runs.push_back({begin.path, node, begin.number});
    }
}

}  // namespace raynest
