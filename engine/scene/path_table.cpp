// Numbers repeated names, and writes the tree of nodes with the runs of their placements.
#include "engine/scene/path_table.h"

#include <algorithm>
#include <cstddef>
#include <numeric>

namespace raynest {
namespace {

/// Visits the placements of a description in the order of their paths, including those behind
/// singular instances.
class PlacementWalk {
public:
    PlacementWalk(const SceneDescription& description, const Graph& graph)
        : description_(description),
          traced_(description.objects.size(), nullptr) {
        for (const GraphObject& object : graph.objects) traced_[object.source] = &object;
    }

    /// Calls visit(has_path) for each one.
    template <class Visit>
    void walk(Visit&& visit) const {
        std::vector<Step> way;
        const auto enter = [&](std::uint32_t object, bool has_paths) {
            const ObjectDescription& entered = description_.objects[object];
            if (own_triangles(entered) + entered.record_bounds.size() != 0) visit(has_paths);
            if (!entered.instances.empty()) way.push_back({object, has_paths, 0, 0});
        };
        enter(description_.root, true);
        while (!way.empty()) {
            Step& step = way.back();
            const auto& instances = description_.objects[step.object].instances;
            if (step.next == instances.size()) {
                way.pop_back();
                continue;
            }
            bool has_paths = step.has_paths;
            if (has_paths) {
                const std::vector<std::uint32_t>& traced = traced_[step.object]->declared_as;
                has_paths =
                    step.next_traced < traced.size() && traced[step.next_traced] == step.next;
                if (has_paths) ++step.next_traced;
            }
            enter(instances[step.next++].object, has_paths);
        }
    }

private:
    struct Step {
        std::uint32_t object;
        bool has_paths;
        std::uint32_t next;         ///< instance
        std::uint32_t next_traced;  ///< in GraphObject::declared_as
    };

    const SceneDescription& description_;
    std::vector<const GraphObject*> traced_;  ///< by object of the description
};

}  // namespace

std::vector<std::uint32_t> number_siblings(std::span<const std::uint32_t> names,
                                           std::span<const std::uint32_t> counts) {
    const auto count_of = [&](std::uint32_t i) { return counts.empty() ? 1 : counts[i]; };
    std::vector<std::uint32_t> order(names.size());
    std::iota(order.begin(), order.end(), 0U);
    // Skip the sort if possible: a million placements of one name are sorted already.
    if (!std::is_sorted(names.begin(), names.end())) {
        std::sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) {
            return names[a] != names[b] ? names[a] < names[b] : a < b;
        });
    }
    std::vector<std::uint32_t> numbers(names.size(), no_id);
    for (auto first = order.begin(); first != order.end();) {
        const std::uint32_t name = names[*first];
        const auto end =
            std::find_if(first, order.end(), [&](std::uint32_t i) { return names[i] != name; });
        const bool unique = name != 0 && end - first == 1 && count_of(*first) == 1;
        std::uint32_t next = 0;
        for (; first != end; ++first) {
            if (!unique) numbers[*first] = next;
            next += count_of(*first);
        }
    }
    return numbers;
}

std::vector<std::uint32_t> number_nodes(const std::vector<PathNodeDescription>& nodes,
                                        std::span<const std::uint32_t> names) {
    std::vector<std::uint32_t> numbers(nodes.size(), no_id);
    std::vector<std::uint32_t> counts;
    for (std::size_t first = 1; first < nodes.size();) {
        counts.clear();
        std::size_t end = first;
        for (; end < nodes.size() && nodes[end].parent == nodes[first].parent; ++end)
            counts.push_back(std::max(nodes[end].placements, 1U));
        const auto group = number_siblings(names.subspan(first, end - first), counts);
        std::copy(group.begin(), group.end(), numbers.begin() + static_cast<std::ptrdiff_t>(first));
        first = end;
    }
    return numbers;
}

void add_path_nodes(const SceneDescription& description, const Graph& graph, Content& content) {
    if (description.path_nodes.empty()) return;
    std::vector<std::uint32_t> names;
    std::vector<PathNode>& nodes = content.path_nodes;
    nodes.reserve(description.path_nodes.size());
    for (const PathNodeDescription& node : description.path_nodes) {
        names.push_back(content.names.add(path_step_text(node.name)));
        nodes.push_back({node.parent, names.back(), no_id, node.source, no_id});
    }
    const auto numbers = number_nodes(description.path_nodes, names);
    for (std::size_t i = 0; i < nodes.size(); ++i) nodes[i].number = numbers[i];

    std::vector<PathRun>& runs = content.path_runs;
    std::uint64_t path = 0;
    auto placed = description.placed_nodes.begin();
    std::uint32_t of_node = 0;  // placements of *placed so far
    PlacementWalk(description, graph).walk([&](bool has_path) {
        PathNode& node = nodes[*placed];
        if (has_path) {
            const std::uint32_t number = node.number == no_id ? 0 : node.number + of_node;
            // A run continues while path ids and numbers both do; a singular placement ends it.
            const bool goes_on = !runs.empty() && runs.back().node == *placed &&
                                 number - runs.back().number == path - runs.back().first_path;
            if (node.first_run == no_id) node.first_run = static_cast<std::uint32_t>(runs.size());
            if (!goes_on) runs.push_back({path, *placed, number});
            ++path;
        }
        if (++of_node == description.path_nodes[*placed].placements) {
            ++placed;
            of_node = 0;
        }
    });
}

}  // namespace raynest
