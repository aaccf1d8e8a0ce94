#include "engine/scene/graph.h"

#include "engine/bvh/node.h"
#include "engine/scene/snapshot.h"

#include <algorithm>
#include <utility>

namespace raynest {
namespace {

bool add(Placements& sum, const Placements& more) {
    return !__builtin_add_overflow(sum.placement_count, more.placement_count,
                                   &sum.placement_count) &&
           !__builtin_add_overflow(sum.triangles, more.triangles, &sum.triangles) &&
           sum.placement_count <= scene_paths_max;
}

class Resolver {
public:
    explicit Resolver(const SceneDescription& description)
        : description_(description),
          entries_(description.objects.size()) {}

    Result<Graph> resolve() {
        if (description_.root >= description_.objects.size()) {
            return fail(ErrorCode::scene_invalid, "the scene has no root object");
        }
        if (auto ordered = order_children_first(); !ordered) {
            return tl::unexpected(ordered.error());
        }
        return keep_traced();
    }

private:
    enum class State : std::uint8_t { unseen, open, done };

    /// An object of the description. `declared` also counts placements behind singular instances.
    struct Entry {
        State state = State::unseen;
        bool traced = false;
        Placements declared;
        std::uint32_t mask = 0;  ///< union of the masks of its contents
        GraphObject object;
    };

    struct Step {
        std::uint32_t object;
        std::uint32_t next_instance;
    };

    Result<void> order_children_first() {
        std::vector<Step> way;
        const auto open = [&](std::uint32_t object) {
            entries_[object].state = State::open;
            way.push_back({object, 0});
        };
        open(description_.root);
        while (!way.empty()) {
            Step& step = way.back();
            const std::vector<InstanceDescription>& instances =
                description_.objects[step.object].instances;
            if (step.next_instance == instances.size()) {
                const std::uint32_t finished = step.object;
                way.pop_back();
                if (auto closed = close(finished); !closed) return closed;
                continue;
            }
            const std::uint32_t child = instances[step.next_instance++].object;
            if (child >= description_.objects.size()) {
                return fail(ErrorCode::scene_invalid,
                            "object " + label(step.object) + " places object #" +
                                std::to_string(child) + ", which does not exist");
            }
            if (entries_[child].state == State::open) {
                return fail(ErrorCode::scene_invalid,
                            "object " + label(child) + " contains itself: break the cycle");
            }
            if (entries_[child].state == State::unseen) open(child);
        }
        return {};
    }

    /// Sums up the children, which are all complete.
    Result<void> close(std::uint32_t index) {
        const ObjectDescription& source = description_.objects[index];
        Entry& entry = entries_[index];
        entry.state = State::done;
        order_.push_back(index);
        if (source.instances.size() > leaf_instance_max) {
            return fail(ErrorCode::limit_exceeded, "object " + label(index) + " has more than " +
                                                       std::to_string(leaf_instance_max) +
                                                       " instances: nest them in groups");
        }

        GraphObject& object = entry.object;
        object.source = index;
        object.traced.triangles = own_triangles(source);
        object.traced.placement_count =
            object.traced.triangles + source.record_bounds.size() != 0 ? 1U : 0U;
        entry.declared = object.traced;
        if (object.traced.placement_count != 0) entry.mask = ~0U;
        for (std::uint32_t i = 0; i < source.instances.size(); ++i) {
            const InstanceDescription& instance = source.instances[i];
            const Entry& child = entries_[instance.object];
            if (!add(entry.declared, child.declared)) return too_many_paths(index);

            Transform to_object;
            if (!invert(instance.transform, to_object)) {
                if (singular_.empty() && child.declared.placement_count != 0)
                    singular_ = instance_label(description_, index, i);
                continue;
            }
            InstanceRecord record{};
            record.to_object = by_columns(to_object);
            record.object = instance.object;
            record.mask = instance.mask & child.mask;
            entry.mask |= record.mask;
            record.path_base = object.traced.placement_count;
            if (!add(object.traced, child.object.traced)) return too_many_paths(index);
            object.levels = std::max(object.levels, child.object.levels + 1);
            object.instances.push_back(record);
            object.declared_as.push_back(i);
        }
        if (object.levels > scene_depth_max) {
            return fail(ErrorCode::limit_exceeded, "object " + label(index) + " nests more than " +
                                                       std::to_string(scene_depth_max) +
                                                       " levels: flatten some");
        }
        return {};
    }

    /// Drops objects that only singular instances reach and numbers the others, children first.
    Graph keep_traced() {
        entries_[description_.root].traced = true;
        for (auto at = order_.rbegin(); at != order_.rend(); ++at) {
            if (!entries_[*at].traced) continue;
            for (const InstanceRecord& instance : entries_[*at].object.instances) {
                entries_[instance.object].traced = true;
            }
        }

        Graph graph;
        graph.skipped = description_.skipped;
        graph.singular = std::move(singular_);
        const Entry& root = entries_[description_.root];
        graph.declared_leaves = root.declared.placement_count;
        std::uint64_t lost_unique = 0;
        for (const std::uint32_t index : order_) {
            if (!entries_[index].traced) lost_unique += own_triangles(description_.objects[index]);
        }
        const auto note = [&](const char* reason, std::uint64_t count) {
            if (count != 0) graph.skipped[reason] += count;
        };
        note("singular_instances",
             root.declared.placement_count - root.object.traced.placement_count);
        note("singular_instance_triangles", root.declared.triangles - root.object.traced.triangles);
        note("singular_unique_triangles", lost_unique);

        std::vector<std::uint32_t> number(entries_.size(), no_id);
        for (const std::uint32_t index : order_) {
            if (!entries_[index].traced) continue;
            number[index] = static_cast<std::uint32_t>(graph.objects.size());
            GraphObject& object = graph.objects.emplace_back(std::move(entries_[index].object));
            for (InstanceRecord& instance : object.instances) {
                instance.object = number[instance.object];
            }
        }
        return graph;
    }

    [[nodiscard]] std::string label(std::uint32_t object) const {
        return object_label(description_, object);
    }

    [[nodiscard]] tl::unexpected<Error> too_many_paths(std::uint32_t object) const {
        return fail(ErrorCode::limit_exceeded,
                    "object " + label(object) + " places more than 2^63 leaves or triangles");
    }

    const SceneDescription& description_;
    std::vector<Entry> entries_;
    std::vector<std::uint32_t> order_;
    std::string singular_;
};

}  // namespace

Result<Graph> resolve_graph(const SceneDescription& description) {
    return Resolver(description).resolve();
}

std::string object_label(const SceneDescription& description, std::uint32_t object) {
    const std::string& name = description.objects[object].name;
    return name.empty() ? '#' + std::to_string(object) : '\'' + name + '\'';
}

std::string instance_label(const SceneDescription& description, std::uint32_t object,
                           std::uint32_t instance) {
    const ObjectDescription& parent = description.objects[object];
    const auto quoted = [](const std::string& name) {
        return name.empty() ? std::string() : " ('" + name + "')";
    };
    if (parent.placed_by.size() != parent.instances.size()) {
        return "instance " + std::to_string(instance) + quoted(parent.instances[instance].name) +
               " of object " + object_label(description, object);
    }
    const std::uint32_t node = parent.placed_by[instance];
    const auto named =
        std::ranges::find(description.path_nodes, node, &PathNodeDescription::source);
    return "node " + std::to_string(node) +
           (named == description.path_nodes.end() ? "" : quoted(named->name));
}

std::uint64_t own_triangles(const ObjectDescription& object) {
    std::uint64_t triangles = 0;
    for (const GeometryDescription& geometry : object.geometries) {
        triangles += geometry.indices.size() / 3;
    }
    return triangles;
}

}  // namespace raynest
