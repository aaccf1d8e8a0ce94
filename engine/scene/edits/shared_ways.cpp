#include "engine/scene/edits/shared_ways.h"

#include "engine/scene/edits/deform.h"
#include "engine/scene/edits/linked_paths.h"
#include "engine/scene/format.h"

#include <algorithm>
#include <iterator>
#include <map>
#include <utility>

namespace raynest {
namespace {

/// Bytes that unshare() needs at most for a way and for an object that it copies, beside the copy.
constexpr std::uint64_t bytes_per_way = 256, bytes_per_copy = 256;

/// Returns the bytes of a copy of an object, without those below it, at most.
std::uint64_t copy_bytes(const SceneView& view, const ObjectRecord& object) {
    constexpr std::uint64_t vertex_bytes = 2 * sizeof(Vec3) + 2 * sizeof(Vec2) + sizeof(Vec4) + 4;
    constexpr std::uint64_t triangle_bytes = 3 * sizeof(std::uint32_t) + sizeof(Opacity);
    constexpr std::uint64_t instance_bytes = sizeof(InstanceRecord) + sizeof(InstanceInfo) + 4;
    constexpr std::uint64_t geometry_bytes =
        sizeof(GeometryRecord) + sizeof(GeometryShading) + 8 * format::alignment;
    return sizeof object + object.node_count * sizeof(Node) +
           object.block_count * (sizeof(TriangleBlock) + sizeof(TexcoordBlock)) +
           records_bytes(object) + object.instance_count * instance_bytes +
           object.geometry_count * geometry_bytes + vertex_count(view, object) * vertex_bytes +
           object.triangle_count * triangle_bytes;
}

/// Returns how many bytes the added scenes take, besides what is copied of the base.
std::uint64_t bytes_to_add(const Snapshot& scene, const SceneChanges& changes) {
    std::map<const Snapshot*, std::uint64_t> nodes;  ///< nodes of a copy, by its scene
    // Nodes and runs stand in the content and in the arena, and their new numbers beside them.
    constexpr std::uint64_t node_bytes = 2 * sizeof(PathNode) + 2 * sizeof(std::uint32_t);
    const bool has_nodes = nodes_name(scene, changes.added);
    std::uint64_t bytes = 0;
    if (has_nodes && scene.paths().node_count == 0)
        bytes += nodes_of_copy(scene) * (node_bytes + 2 * sizeof(PathRun));
    for (const AddedScene& added : changes.added) {
        const auto [known, is_new] = nodes.try_emplace(added.scene.get(), 0);
        if (is_new && has_nodes) known->second = nodes_of_copy(*added.scene);
        const std::uint64_t runs =
            std::max<std::uint64_t>(known->second, added.scene->paths().run_count);
        const std::uint64_t each = sizeof(InstanceRecord) + sizeof(InstanceInfo) + sizeof(Node) +
                                   known->second * node_bytes + 2 * runs * sizeof(PathRun);
        bytes += added.scene->bytes().size() + added.to_scene.size() * each;
    }
    return bytes;
}

}  // namespace

std::vector<WayStep> steps_to(const SceneView& view, const InstancePlace& place) {
    std::vector<WayStep> steps;
    std::uint32_t object = view.root;
    const auto enter = [&](std::uint32_t at) {
        const ObjectRecord& record = view.objects[object];
        if (at >= record.instance_count) return false;
        steps.push_back({object, record.first_instance + at});
        object = view.instances[record.first_instance + at].object;
        return true;
    };
    if (!enter(place.outermost) || !std::ranges::all_of(place.below, enter)) steps.clear();
    return steps;
}

std::uint32_t object_of(const SceneView& view, const InstancePlace& place) {
    return view.instances[steps_to(view, place).back().instance].object;
}

Result<std::vector<InstancePlace>> shared_ways(const Snapshot& scene, const SceneChanges& changes,
                                               const EditGuard& guard) {
    const SceneView& view = scene.view();
    const bool has_nodes = scene.paths().node_count != 0;
    std::uint64_t most = changes.moves.size() + changes.masks.size() + changes.deformed.size() +
                         changes.materials.size();
    if (!has_nodes && !changes.uids.empty()) most += nested_instances(view, changes.uids);
    if (auto room = guard.allows(most * bytes_per_way); !room) return tl::unexpected(room.error());
    std::vector<InstancePlace> ways;
    for (const auto& move : changes.moves)
        if (!move.instance.below.empty()) ways.push_back(move.instance);
    for (const auto& mask : changes.masks)
        if (!mask.instance.below.empty()) ways.push_back(mask.instance);
    if (!has_nodes)
        for (const auto& change : changes.uids) {
            if (!change.instance.below.empty()) ways.push_back(change.instance);
            std::ranges::move(places_within(view, change.instance, nested_uids_max),
                              std::back_inserter(ways));
        }
    if (ways.empty() && changes.deformed.empty() && changes.materials.empty()) return ways;
    const std::vector<std::uint32_t>& uses = scene.uses();
    const auto is_shared = [&](const InstancePlace& place) {
        return std::ranges::any_of(steps_to(view, place), [&](const WayStep& step) {
            return step.object != view.root && uses[step.object] > 1;
        });
    };
    std::erase_if(ways, [&](const InstancePlace& place) { return !is_shared(place); });
    // A mesh all of whose placements change alike stays one.
    std::uint32_t changes_seen = 0;
    const auto part_meshes = [&](const auto& meshes, auto change_of) {
        struct Alike {
            std::uint32_t number;    ///< the change's number
            std::uint32_t uses = 0;  ///< uses of the object by objects that are not shared
        };
        std::map<std::pair<std::uint32_t, decltype(change_of(meshes[0]))>, Alike> alike;
        for (const auto& mesh : meshes) {
            const std::pair change(object_of(view, mesh.instance), change_of(mesh));
            const auto known = alike.try_emplace(change, Alike{changes_seen++}).first;
            if (!is_shared(mesh.instance)) ++known->second.uses;
        }
        for (const auto& mesh : meshes) {
            const std::uint32_t object = object_of(view, mesh.instance);
            const Alike& change = alike.at({object, change_of(mesh)});
            if (change.uses == uses[object]) continue;
            ways.push_back(mesh.instance);
            ways.back().below.push_back(alike_bit | change.number);
        }
    };
    part_meshes(changes.deformed,
                [](const MeshVertices& mesh) { return mesh.vertices.positions.data(); });
    part_meshes(changes.materials, [](const MeshMaterial& mesh) { return mesh.material; });
    return ways;
}

std::uint64_t bytes_to_unshare(const Snapshot& scene, const std::vector<InstancePlace>& ways) {
    if (ways.empty()) return 0;
    struct Copies {
        const SceneView& view;
        std::uint64_t bytes = 0, count = 0;

        static std::uint32_t keep(std::uint32_t object) { return object; }
        std::uint32_t copy(std::uint32_t object, const std::vector<std::uint32_t>& /*children*/) {
            if (object == view.root) return object;
            bytes += copy_bytes(view, view.objects[object]);
            ++count;
            return object;
        }
    } copies{scene.view()};
    WayCopies(scene.view(), copies).copy(ways);
    // The content of the copies is there until the arena is written.
    return 2 * copies.bytes + ways.size() * bytes_per_way + copies.count * bytes_per_copy;
}

std::uint64_t bytes_beside(const Snapshot& scene, const SceneChanges& changes,
                           const std::vector<InstancePlace>& ways) {
    const auto is_nested = [](const auto& change) { return !change.instance.below.empty(); };
    const std::uint64_t bytes = bytes_to_add(scene, changes) + bytes_to_unshare(scene, ways);
    const bool moves_nodes = !changes.uids.empty() && scene.paths().node_count != 0;
    const bool is_linked = bytes != 0 || !changes.removed.empty() || moves_nodes;
    const bool is_copied = is_linked || !changes.deformed.empty() || !changes.materials.empty() ||
                           std::ranges::any_of(changes.moves, is_nested) ||
                           std::ranges::any_of(changes.masks, is_nested);
    // The content of a linked scene is there until its arena is written.
    const std::uint64_t copies = is_linked ? 2 : is_copied ? 1 : 0;
    return bytes + copies * scene.bytes().size();
}

}  // namespace raynest
