// A flat scene that came out of a tree of nodes: the same tree again, with the names of its paths.
//
// The nodes of the file disappeared when they were read, and their transforms were composed. So the
// inner nodes have no transform now, and each placement has the whole of it, which is exact.
#include "engine/assets/gltf/write/tables.h"

#include <fmt/format.h>

#include <string>
#include <vector>

namespace raynest::gltf {
namespace {

class PathNodeWriter {
public:
    PathNodeWriter(const Snapshot& scene, std::span<const std::uint32_t> mesh_of, Tables& tables)
        : scene_(scene),
          view_(scene.view()),
          paths_(scene.paths()),
          mesh_of_(mesh_of),
          tables_(tables),
          below_(paths_.node_count),
          own_(paths_.node_count) {
        for (std::uint32_t i = 1; i < paths_.node_count; ++i)
            below_[paths_.nodes[i].parent].push_back(i);
        const ObjectRecord& root = view_.objects[view_.root];
        for (std::uint32_t r = 0; r < paths_.run_count; ++r) {
            const PathRun& run = paths_.runs[r];
            const std::uint64_t end =
                r + 1 < paths_.run_count ? paths_.runs[r + 1].first_path : root.placement_count;
            for (std::uint64_t path = run.first_path; path < end; ++path)
                own_[run.node].push_back(root.first_instance + static_cast<std::uint32_t>(path));
        }
    }

    /// Children before parents. No recursion: a file may nest as deeply as its nodes are many.
    void write() {
        std::vector<std::vector<std::uint32_t>> made(paths_.node_count);  // the rows of each
        for (std::uint32_t i = paths_.node_count; i-- > 0 && !tables_.ends();) {
            const std::string name = i == 0 ? "" : node_name(view_.names + paths_.nodes[i].name);
            std::vector<std::uint32_t> children;
            for (const std::uint32_t instance : own_[i]) {
                if (tables_.ends()) return;
                children.push_back(place(instance, name));
                if (children.back() != paths_.nodes[i].source) ++renumbered_;
            }
            for (const std::uint32_t child : below_[i]) {
                children.insert(children.end(), made[child].begin(), made[child].end());
                made[child] = {};
            }
            // A node without children of its own is its placements; else they lie within it.
            if (i != 0 && !below_[i].empty()) children = {inner(name, children)};
            made[i] = std::move(children);
        }
        tables_.roots = std::move(made[0]);
        if (renumbered_ != 0) tables_.warnings.push_back(renumbered_text(renumbered_));
    }

private:
    std::uint32_t place(std::uint32_t index, const std::string& name) {
        const InstanceRecord& instance = view_.instances[index];
        const std::uint32_t mesh = mesh_of_[instance.object];
        std::string row = "{\"name\":" + json_text(name);
        if (mesh != no_id) row += fmt::format(",\"mesh\":{}", mesh);
        const InstanceInfo& info = view_.instance_infos[index];
        row += ",\"matrix\":" + matrix_text(turned(scene_, info.to_parent));
        if (info.mask != 0xFFFFFFFFU)
            row += fmt::format(R"(,"extras":{{"raynest":{{"mask":{}}}}})", info.mask);
        return tables_.nodes.add(row + '}');
    }

    std::uint32_t inner(const std::string& name, const std::vector<std::uint32_t>& children) {
        return tables_.nodes.add(fmt::format(R"({{"name":{},"children":{}}})", json_text(name),
                                             nlohmann::json(children).dump()));
    }

    const Snapshot& scene_;
    const SceneView& view_;
    const PathTable& paths_;
    std::span<const std::uint32_t> mesh_of_;
    Tables& tables_;
    std::vector<std::vector<std::uint32_t>> below_;  ///< by node: its children
    std::vector<std::vector<std::uint32_t>> own_;    ///< by node: instances of the root
    std::uint64_t renumbered_ = 0;                   ///< instances whose user id will be another
};

}  // namespace

std::string renumbered_text(std::uint64_t count) {
    return fmt::format(
        "the user ids of {} instances become others: in a glTF file they are the indices of its "
        "nodes",
        count);
}

bool write_path_nodes(const Snapshot& scene, std::span<const std::uint32_t> mesh_of,
                      Tables& tables) {
    const SceneView& view = scene.view();
    const ObjectRecord& root = view.objects[view.root];
    if (scene.paths().node_count == 0 || root.has_own_primitives() ||
        root.placement_count != root.instance_count)
        return false;
    for (std::uint32_t i = 0; i < root.instance_count; ++i)
        if (view.objects[view.instances[root.first_instance + i].object].instance_count != 0)
            return false;
    PathNodeWriter(scene, mesh_of, tables).write();
    return true;
}

}  // namespace raynest::gltf
