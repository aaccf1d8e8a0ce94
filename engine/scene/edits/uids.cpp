#include "engine/scene/edits/uids.h"

#include "engine/scene/edits/placed_sums.h"
#include "engine/scene/edits/shared_ways.h"

#include <algorithm>
#include <optional>
#include <utility>

namespace raynest {
namespace {

/// Placements of a node that follow each other and have one user id.
struct UidPart {
    std::uint32_t number;              ///< the first placement's
    std::optional<std::uint32_t> uid;  ///< nothing: the node's
};

/// The id that the paths of a node and of those below it get.
struct Given {
    bool any_path = false;
    std::optional<std::uint32_t> uid;  ///< the user id of all; nothing: several, or none

    void add(const Given& other) {
        if (!other.any_path) return;
        if (!any_path)
            *this = other;
        else if (uid != other.uid)
            uid.reset();
    }
};

/// Consecutive paths that get one id.
struct UidRange {
    std::uint64_t begin, end;
    std::uint32_t uid;
};

UidRange range_of(const SceneView& view, const InstanceUid& change) {
    std::uint64_t begin = 0;
    std::uint32_t object = view.root;
    for (const WayStep& step : steps_to(view, change.instance)) {
        begin += view.instances[step.instance].path_base;
        object = view.instances[step.instance].object;
    }
    return {begin, begin + view.objects[object].placement_count, change.uid};
}

/// Returns disjoint ranges, ascending.
std::vector<UidRange> ranges_of(const SceneView& view, std::span<const InstanceUid> uids) {
    std::vector<UidRange> ranges, open;  // the open ones lie within each other
    std::uint64_t at = 0;
    const auto go_to = [&](std::uint64_t path) {
        for (; !open.empty(); open.pop_back()) {
            const UidRange& inner = open.back();
            const std::uint64_t end = std::min(inner.end, path);
            if (at < end) ranges.push_back({at, end, inner.uid});
            at = std::max(at, end);
            if (inner.end > path) break;
        }
        at = path;
    };
    for (const InstanceUid& change : uids) {
        const UidRange range = range_of(view, change);
        go_to(range.begin);
        open.push_back(range);
    }
    go_to(~0ULL);
    return ranges;
}

/// Says which paths have which id.
class Uids {
public:
    explicit Uids(std::span<const UidRange> ranges) : ranges_(ranges) {}

    /// Returns the id of a path, and the end of the paths from there on that have the same answer.
    /// Paths must ascend from call to call.
    std::pair<std::optional<std::uint32_t>, std::uint64_t> at(std::uint64_t path) {
        while (!ranges_.empty() && ranges_.front().end <= path) ranges_ = ranges_.subspan(1);
        if (ranges_.empty()) return {std::nullopt, ~0ULL};
        const UidRange& next = ranges_.front();
        if (path < next.begin) return {std::nullopt, next.begin};
        return {next.uid, next.end};
    }

private:
    std::span<const UidRange> ranges_;
};

}  // namespace

std::uint64_t nested_instances(const SceneView& view, std::span<const InstanceUid> uids) {
    std::vector<std::uint64_t> sums;  // a look at the whole scene, which meshes do not need
    std::uint64_t nested = 0;
    for (const InstanceUid& change : uids) {
        const std::uint64_t itself = change.instance.below.empty() ? 0 : 1;
        const std::uint32_t object = object_of(view, change.instance);
        std::uint64_t within = 0;
        if (view.objects[object].instance_count != 0) {
            if (sums.empty())
                sums = placed_sums(view, [](const ObjectRecord&) { return std::uint64_t{1}; });
            within = sums[object] - 1;
        }
        nested = std::min<std::uint64_t>(1ULL << 62, nested + within + itself);
    }
    return nested;
}

std::vector<InstancePlace> places_within(const SceneView& view, const InstancePlace& place,
                                         std::uint64_t most) {
    std::vector<InstancePlace> places;
    std::vector<std::uint32_t> way = place.below;
    const auto look = [&](const auto& self, std::uint32_t object) -> void {
        const ObjectRecord& record = view.objects[object];
        for (std::uint32_t i = 0; i < record.instance_count && places.size() < most; ++i) {
            way.push_back(i);
            places.emplace_back(place.outermost, way);
            self(self, view.instances[record.first_instance + i].object);
            way.pop_back();
        }
    };
    look(look, object_of(view, place));
    return places;
}

void set_node_uids(const Snapshot& base, std::span<const InstanceUid> uids, Content& content) {
    const std::vector<PathNode> nodes = std::exchange(content.path_nodes, {});
    const std::vector<PathRun> runs = std::exchange(content.path_runs, {});
    std::vector<std::vector<UidPart>> parts(nodes.size());
    const std::vector<UidRange> ranges = ranges_of(base.view(), uids);
    Uids wanted(ranges);
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
    std::vector<Given> given;          // by node
    std::vector<bool> places_nothing;  // by node: itself
    for (std::uint32_t i = 0; i < nodes.size(); ++i) {
        made[i] = static_cast<std::uint32_t>(content.path_nodes.size());
        PathNode node = nodes[i];
        node.parent = made[node.parent];
        node.first_run = no_id;
        if (parts[i].empty()) {
            content.path_nodes.push_back(node);
            given.emplace_back();
            places_nothing.push_back(true);
        }
        for (const UidPart& part : parts[i]) {
            PathNode& own = content.path_nodes.emplace_back(node);
            if (&part != &parts[i].front()) own.number = part.number;
            own.source = part.uid.value_or(node.source);
            given.push_back({true, part.uid});
            places_nothing.push_back(false);
        }
    }
    // A node that places nothing itself has the id that all below it get.
    for (std::size_t i = given.size(); i-- > 1;) {
        PathNode& node = content.path_nodes[i];
        if (places_nothing[i]) node.source = given[i].uid.value_or(node.source);
        given[node.parent].add(given[i]);
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
