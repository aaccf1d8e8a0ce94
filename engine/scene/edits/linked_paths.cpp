#include "engine/scene/edits/linked_paths.h"

#include <algorithm>
#include <deque>
#include <utility>
#include <vector>

namespace raynest {
namespace {

/// Tells which nodes stay: all but those that had placements and have none any more.
std::vector<bool> nodes_that_stay(const PathTable& paths, std::span<const PathRun> runs) {
    std::vector<bool> had(paths.node_count), has(paths.node_count);
    for (std::uint32_t r = 0; r < paths.run_count; ++r) had[paths.runs[r].node] = true;
    for (const PathRun& run : runs) has[run.node] = true;
    for (std::uint32_t i = paths.node_count; i-- > 1;) {
        if (had[i]) had[paths.nodes[i].parent] = true;
        if (has[i]) has[paths.nodes[i].parent] = true;
    }
    for (std::uint32_t i = 0; i < paths.node_count; ++i) has[i] = i == 0 || has[i] || !had[i];
    return has;
}

/// Returns the first node of each level below the scene itself, and the end of the last one.
std::vector<std::uint32_t> levels_of(const PathTable& paths) {
    std::vector<std::uint32_t> starts{1};
    for (std::uint32_t i = 1; i < paths.node_count; ++i)
        if (paths.nodes[i].parent >= starts.back()) starts.push_back(i);
    starts.push_back(paths.node_count);
    return starts;
}

/// The tree of nodes of a scene; made of its instances where it has none.
class NodeTree {
public:
    explicit NodeTree(const Snapshot& scene) {
        table_ = scene.paths();
        if (table_.node_count != 0) return;
        const SceneView& view = scene.view();
        struct Entry {
            std::uint32_t object;
            std::uint64_t first_path;
        };
        std::vector<Entry> entries{{view.root, 0}};
        nodes_.push_back({0, view.objects[view.root].name, no_id, no_id, no_id});
        for (std::uint32_t node = 0; node < entries.size(); ++node) {
            const auto [number, first_path] = entries[node];
            const ObjectRecord& object = view.objects[number];
            if (object.has_own_primitives()) {
                const std::uint32_t own = nodes_[node].number;
                runs_.push_back({first_path, node, own == no_id ? 0 : own});
            }
            for (std::uint32_t i = 0; i < object.instance_count; ++i) {
                const std::uint32_t at = object.first_instance + i;
                const InstanceRecord& instance = view.instances[at];
                if (view.objects[instance.object].placement_count == 0) continue;
                nodes_.push_back({node, view.instance_infos[at].name,
                                  table_.numbers == nullptr ? no_id : table_.numbers[at],
                                  view.instance_infos[at].uid, no_id});
                entries.push_back({instance.object, first_path + instance.path_base});
            }
        }
        std::ranges::sort(runs_, {}, &PathRun::first_path);
        table_.nodes = nodes_.data();
        table_.runs = runs_.data();
        table_.node_count = static_cast<std::uint32_t>(nodes_.size());
        table_.run_count = static_cast<std::uint32_t>(runs_.size());
    }
    NodeTree(const NodeTree&) = delete;
    NodeTree& operator=(const NodeTree&) = delete;

    [[nodiscard]] const PathTable& table() const { return table_; }

private:
    PathTable table_;
    std::vector<PathNode> nodes_;
    std::vector<PathRun> runs_;
};

/// The user id of a scene's only placement; no_id where it has more, or none of its own.
std::uint32_t only_uid(const Snapshot& scene) {
    if (scene.statistics().instances != 1) return no_id;
    const NodeTree tree(scene);
    return tree.table().nodes[tree.table().runs[0].node].source;
}

}  // namespace

bool is_one_node(const Snapshot& added) {
    const std::uint64_t placements = added.statistics().instances;
    return placements == 1 || (added.paths().node_count == 0 && placements > named_placements_max);
}

std::uint64_t nodes_of_copy(const Snapshot& added) {
    if (is_one_node(added)) return 0;
    return added.paths().node_count != 0 ? added.paths().node_count
                                         : NodeTree(added).table().node_count;
}

bool nodes_name(const Snapshot& base, std::span<const AddedScene> added) {
    if (base.paths().node_count != 0) return true;
    return base.statistics().instances <= named_placements_max &&
           std::ranges::any_of(
               added, [](const AddedScene& part) { return part.scene->paths().node_count != 0; });
}

std::uint32_t next_number(const Snapshot& base, std::uint32_t name) {
    const PathTable& paths = base.paths();
    const std::uint64_t path_count = base.statistics().instances;
    std::uint32_t next = no_id;
    const auto raise = [&](std::uint64_t to) {
        const auto number = static_cast<std::uint32_t>(std::min<std::uint64_t>(to, no_id - 1));
        next = next == no_id ? number : std::max(next, number);
    };
    for (std::uint32_t i = 1; i < paths.node_count && paths.nodes[i].parent == 0; ++i) {
        const PathNode& node = paths.nodes[i];
        if (node.name != name) continue;
        raise(node.number == no_id ? 1 : std::uint64_t{node.number} + 1);
        for (std::uint32_t r = node.first_run; r < paths.run_count && paths.runs[r].node == i; ++r)
            raise(paths.runs[r].number +
                  (end_of_run(paths, r, path_count) - paths.runs[r].first_path));
    }
    return next;
}

Result<void> link_paths(const Snapshot& base, std::span<const PathRange> kept,
                        std::span<const AddedPaths> added, Content& content,
                        const EditGuard& guard) {
    const NodeTree base_tree(base);
    const PathTable& paths = base_tree.table();
    const std::uint64_t path_count = base.statistics().instances;
    const SceneView& view = base.view();
    std::vector<PathNode>& nodes = content.path_nodes;
    std::vector<PathRun>& runs = content.path_runs;

    // The base's runs, with its own numbers of nodes for now.
    std::uint64_t path = 0;
    std::uint32_t r = 0;
    for (const PathRange& range : kept) {
        for (std::uint64_t at = range.first; at < range.end;) {
            while (end_of_run(paths, r, path_count) <= at) ++r;
            const PathRun& run = paths.runs[r];
            const std::uint64_t end = std::min(end_of_run(paths, r, path_count), range.end);
            const auto number = run.number + static_cast<std::uint32_t>(at - run.first_path);
            const bool goes_on = !runs.empty() && runs.back().node == run.node &&
                                 number - runs.back().number == path - runs.back().first_path;
            if (!goes_on) runs.push_back({path, run.node, number});
            path += end - at;
            at = end;
        }
    }
    const std::vector<bool> stays = nodes_that_stay(paths, runs);

    // Nodes stand breadth first, so the trees are merged level by level.
    const std::vector<std::uint32_t> base_levels = levels_of(paths);
    std::vector<std::uint32_t> made(paths.node_count, 0);
    using Nodes = std::vector<std::uint32_t>;  ///< a copied tree: the new index of each
    std::vector<std::vector<Nodes>> copies(added.size());
    std::deque<NodeTree> trees;
    std::vector<const PathTable*> tables(added.size());
    std::vector<std::vector<std::uint32_t>> levels(added.size());
    std::vector<std::uint32_t> tops(added.size());  // tops of those with one node
    const auto push = [&](PathNode node, std::uint32_t parent, std::uint32_t uid = no_id) {
        const std::uint32_t source = uid == no_id ? node.source : uid;
        nodes.push_back({parent, node.name, node.number, source, no_id});
        return static_cast<std::uint32_t>(nodes.size() - 1);
    };
    push(paths.nodes[0], 0);
    nodes[0].name = content.names.add(view.names + paths.nodes[0].name);
    std::size_t level_count = std::max<std::size_t>(base_levels.size() - 1, 1);
    for (std::size_t a = 0; a < added.size(); ++a) {
        if (is_one_node(*added[a].scene)) continue;
        tables[a] = &trees.emplace_back(*added[a].scene).table();
        levels[a] = levels_of(*tables[a]);
        level_count = std::max(level_count, levels[a].size());
    }
    for (std::size_t level = 0; level < level_count; ++level) {
        if (level + 1 < base_levels.size())
            for (std::uint32_t i = base_levels[level]; i < base_levels[level + 1]; ++i) {
                if (!stays[i]) continue;
                PathNode node = paths.nodes[i];
                node.name = content.names.add(view.names + node.name);
                made[i] = push(node, made[node.parent]);
            }
        for (std::size_t a = 0; a < added.size(); ++a) {
            const AddedPaths& part = added[a];
            if (level == 0) {
                if (is_one_node(*part.scene)) {
                    const std::uint32_t uid = part.uid != no_id ? part.uid : only_uid(*part.scene);
                    tops[a] = push({0, part.name, part.first_number, uid, no_id}, 0);
                    continue;
                }
                for (std::uint32_t c = 0; c < part.copies; ++c) {
                    Nodes& copy = copies[a].emplace_back(tables[a]->node_count);
                    const std::uint32_t number =
                        part.first_number == no_id ? no_id : part.first_number + c;
                    copy[0] = push({0, part.name, number, part.uid, no_id}, 0);
                }
                continue;
            }
            for (Nodes& copy : copies[a]) {
                if (auto on = guard.allows(0); !on) return on;
                if (level >= levels[a].size()) continue;
                for (std::uint32_t i = levels[a][level - 1]; i < levels[a][level]; ++i) {
                    PathNode node = tables[a]->nodes[i];
                    node.name = content.names.add(part.scene->view().names + node.name);
                    copy[i] = push(node, copy[node.parent], part.uid);
                }
            }
        }
    }

    for (PathRun& run : runs) run.node = made[run.node];
    for (std::size_t a = 0; a < added.size(); ++a) {
        const AddedPaths& part = added[a];
        const std::uint64_t placements = part.scene->statistics().instances;
        if (placements == 0) continue;
        if (is_one_node(*part.scene)) {
            runs.push_back({path, tops[a], part.first_number == no_id ? 0 : part.first_number});
            path += placements * part.copies;
            continue;
        }
        for (const Nodes& copy : copies[a]) {
            const PathTable& theirs = *tables[a];
            for (std::uint32_t i = 0; i < theirs.run_count; ++i)
                runs.push_back({path + theirs.runs[i].first_path, copy[theirs.runs[i].node],
                                theirs.runs[i].number});
            path += placements;
        }
    }
    for (std::uint32_t i = static_cast<std::uint32_t>(runs.size()); i-- > 0;)
        nodes[runs[i].node].first_run = i;
    return {};
}

void join_nodes(Content& content) {
    const std::vector<PathNode> nodes = std::exchange(content.path_nodes, {});
    const std::vector<PathRun> runs = std::exchange(content.path_runs, {});
    std::vector<bool> has_children(nodes.size());
    for (std::size_t i = 1; i < nodes.size(); ++i) has_children[nodes[i].parent] = true;
    const auto goes_on = [&](std::uint32_t i) {
        const PathNode& before = nodes[i - 1];
        const PathNode& node = nodes[i];
        if (node.parent != before.parent || node.name != before.name ||
            node.source != before.source || has_children[i] || has_children[i - 1] ||
            node.number == no_id || before.number == no_id || node.first_run == no_id ||
            node.first_run == 0 || runs[node.first_run - 1].node != i - 1)
            return false;
        const PathRun& run = runs[node.first_run];
        const PathRun& last = runs[node.first_run - 1];
        return run.number - last.number == run.first_path - last.first_path;
    };
    std::vector<std::uint32_t> made(nodes.size());
    std::vector<bool> is_joined(nodes.size());
    for (std::uint32_t i = 0; i < nodes.size(); ++i) {
        is_joined[i] = i > 1 && goes_on(i);
        if (!is_joined[i]) {
            PathNode& node = content.path_nodes.emplace_back(nodes[i]);
            node.parent = made[node.parent];
            node.first_run = no_id;
        }
        made[i] = static_cast<std::uint32_t>(content.path_nodes.size() - 1);
    }
    for (std::uint32_t r = 0; r < runs.size(); ++r) {
        if (is_joined[runs[r].node] && nodes[runs[r].node].first_run == r) continue;
        PathNode& node = content.path_nodes[made[runs[r].node]];
        if (node.first_run == no_id)
            node.first_run = static_cast<std::uint32_t>(content.path_runs.size());
        content.path_runs.push_back({runs[r].first_path, made[runs[r].node], runs[r].number});
    }
}

}  // namespace raynest
