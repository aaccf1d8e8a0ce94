// The node tree -> objects, instances and cameras.
//
// A mesh becomes an object, and a node with a mesh becomes an instance of it. Other nodes
// disappear: their transforms are composed (in double). Shared subtrees (sharing.h) become
// objects in between. The nodes name the paths, so a flat scene and one with shared subtrees print
// the same path. Declaration order is depth-first node order throughout; every walk is iterative.
#include "engine/assets/gltf/describe.h"
#include "engine/assets/gltf/masks.h"
#include "engine/assets/gltf/precision.h"
#include "engine/assets/gltf/sharing.h"
#include "engine/assets/input/messages.h"
#include "engine/scene/camera_pose.h"
#include "engine/scene/graph.h"
#include "engine/scene/snapshot.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <optional>

namespace raynest::gltf {
namespace {

/// A placement takes at least 12 bytes in a file, and nodes may share a list of placements. A file
/// with far more instances than its bytes allow is made to use up memory.
constexpr std::uint64_t instances_free = 1U << 20;
constexpr std::uint64_t bytes_per_instance = 4;

std::vector<std::uint32_t> depth_first(const Model& model) {
    std::vector<std::uint32_t> order;
    std::vector<std::uint32_t> stack(model.roots.rbegin(), model.roots.rend());
    while (!stack.empty()) {
        order.push_back(stack.back());
        const Node& node = model.nodes[stack.back()];
        stack.pop_back();
        stack.insert(stack.end(), node.children.rbegin(), node.children.rend());
    }
    return order;
}

/// Returns the placements of one EXT_mesh_gpu_instancing node, relative to the node.
Result<std::vector<Matrix>> placements_of(const Model& model, const Instancing& instancing) {
    const auto read = [&](std::uint32_t accessor) -> Result<std::vector<float>> {
        if (accessor == no_id) return std::vector<float>{};
        auto values = read_floats(model.accessors[accessor]);
        if (!values) return blame("EXT_mesh_gpu_instancing", values.error());
        return values;
    };
    const auto translations = read(instancing.translation);
    const auto rotations = read(instancing.rotation);
    const auto scales = read(instancing.scale);
    if (!translations) return error_of(translations);
    if (!rotations) return error_of(rotations);
    if (!scales) return error_of(scales);

    std::vector<Matrix> matrices(instancing.count);
    std::uint64_t bad = 0;
    for (std::size_t i = 0; i < matrices.size(); ++i) {
        double t[3] = {0, 0, 0};
        double r[4] = {0, 0, 0, 1};
        double s[3] = {1, 1, 1};
        if (!translations->empty()) std::copy_n(translations->data() + 3 * i, 3, t);
        if (!rotations->empty()) std::copy_n(rotations->data() + 4 * i, 4, r);
        if (!scales->empty()) std::copy_n(scales->data() + 3 * i, 3, s);
        const double length = std::hypot(std::hypot(r[0], r[1]), std::hypot(r[2], r[3]));
        matrices[i] = from_trs(t, r, s);
        const bool finite = std::all_of(matrices[i].begin(), matrices[i].end(),
                                        [](double x) { return std::isfinite(x); });
        bad += finite && length > 1e-12 ? 0U : 1U;
    }
    if (bad != 0) {
        return fail(
            ErrorCode::scene_invalid,
            fmt::format(
                "EXT_mesh_gpu_instancing has {} placements that are not finite or have a zero "
                "rotation",
                bad));
    }
    return matrices;
}

class SceneWriter {
public:
    SceneWriter(const Model& model, const Sharing& sharing, const std::vector<bool>& traceable,
                const Masks& masks, MotionWriter& motion, SceneDescription& scene)
        : model_(model),
          sharing_(sharing),
          traceable_(traceable),
          masks_(masks),
          motion_(motion),
          scene_(scene),
          placements_(scene.objects, scene.origin),
          object_of_(sharing.shapes.size(), no_id) {}

    /// Writes the shared subtrees, then the root; the meshes' objects are already in the scene.
    Result<void> write() {
        for (std::size_t s = 0; s < sharing_.shapes.size(); ++s) {
            const Shape& shape = sharing_.shapes[s];
            if (!shape.is_shared()) continue;
            ObjectDescription object;
            object.name = model_.nodes[shape.example].name;
            // The object is in the space of its top node.
            if (auto done = fill(object, {{shape.example, identity_matrix, true}}); !done) {
                return done;
            }
            placements_.add(object);
            object_of_[s] = static_cast<std::uint32_t>(scene_.objects.size());
            scene_.objects.push_back(std::move(object));
        }
        ObjectDescription root;
        root.name = "scene";
        std::vector<Entry> stack;
        for (auto node = model_.roots.rbegin(); node != model_.roots.rend(); ++node) {
            stack.push_back({*node, model_.nodes[*node].local, false});
        }
        in_scene_ = true;
        if (auto done = fill(root, std::move(stack)); !done) return done;
        scene_.root = static_cast<std::uint32_t>(scene_.objects.size());
        scene_.objects.push_back(std::move(root));
        scene_.rounding = placements_.rounding();
        scene_.file_rounding = placements_.file_rounding();
        return {};
    }

private:
    struct Entry {
        std::uint32_t node;
        Matrix to_object;  ///< from the node's space to that of the object being filled
        bool is_top;       ///< the shared subtree that is being written
    };

    Result<void> fill(ObjectDescription& object, std::vector<Entry> stack) {
        while (!stack.empty()) {
            const Entry entry = stack.back();
            stack.pop_back();
            const std::uint32_t shape = sharing_.shape_of[entry.node];
            if (shape == no_id) continue;
            if (!entry.is_top && object_of_[shape] != no_id) {
                place(object, entry.node, object_of_[shape], entry.to_object, identity_matrix,
                      mask_all);
                continue;
            }
            const Node& node = model_.nodes[entry.node];
            if (auto done = place_mesh(object, node, entry); !done) return done;
            for (auto child = node.children.rbegin(); child != node.children.rend(); ++child) {
                const Matrix& local = model_.nodes[*child].local;
                stack.push_back({*child, multiply(entry.to_object, local), false});
            }
        }
        return {};
    }

    Result<void> place_mesh(ObjectDescription& object, const Node& node, const Entry& entry) {
        if (node.mesh == no_id || !traceable_[node.mesh]) return {};
        // A skinned mesh is already in the scene's space, and so is the object being filled:
        // subtrees with a skin are not shared.
        const Matrix& to_object = node.skin == no_id ? entry.to_object : identity_matrix;
        if (node.instancing.count == 0) {
            place(object, entry.node, node.mesh, to_object, identity_matrix,
                  masks_.of(entry.node, 0));
            return {};
        }
        const auto matrices = placements_of(model_, node.instancing);
        if (!matrices) return error_of(matrices);
        for (std::uint32_t i = 0; i < matrices->size(); ++i)
            place(object, entry.node, node.mesh, multiply(to_object, (*matrices)[i]),
                  (*matrices)[i], masks_.of(entry.node, i));
        return {};
    }

    void place(ObjectDescription& object, std::uint32_t node, std::uint32_t child,
               const Matrix& to_object, const Matrix& to_node, std::uint32_t mask) {
        object.placed_by.push_back(node);
        if (in_scene_) {
            placements_.place_in_scene(child, to_object);
            motion_.place(static_cast<std::uint32_t>(object.instances.size()), node, child,
                          placements_.exact_matrix(child, to_node));
        }
        object.instances.push_back({child, placements_.round(child, to_object), mask, 0, {}});
    }

    const Model& model_;
    const Sharing& sharing_;
    const std::vector<bool>& traceable_;
    const Masks& masks_;
    MotionWriter& motion_;
    SceneDescription& scene_;
    Placements placements_;
    bool in_scene_ = false;  ///< the root is being filled, whose space is the scene's
    std::vector<std::uint32_t> object_of_;
};

/// Counts the instances from the nodes without making them: a bomb is refused before it costs
/// anything.
Result<void> check_instance_count(const Model& model, const std::vector<std::uint32_t>& order,
                                  const ImportLimits& limits) {
    const std::uint64_t limit = std::min(
        limits.instances_max,
        instances_free + (model.upload_bytes + model.decompressed_bytes) / bytes_per_instance);
    std::uint64_t count = 0;
    for (const std::uint32_t index : order) {
        const Node& node = model.nodes[index];
        if (node.mesh != no_id) count += std::max(node.instancing.count, 1U);
        if (count > limit) {
            return fail(ErrorCode::limit_exceeded,
                        fmt::format("the scene places more than {} instances", limit));
        }
    }
    return {};
}

/// Returns the name of a node in paths: its own, else that of its mesh.
const std::string& path_name_of(const Model& model, const Node& node) {
    if (!node.name.empty() || node.mesh == no_id) return node.name;
    return model.meshes[node.mesh].name;
}

/// Adds the nodes of the scene as path nodes, breadth first. A node without a name and a mesh is
/// skipped: its children become children of its parent.
void name_paths(const Model& model, const std::vector<std::uint32_t>& order,
                const std::vector<bool>& traceable, SceneDescription& scene) {
    constexpr std::uint32_t the_scene = no_id;
    std::vector<std::uint32_t> node_of{the_scene};  // by path node
    std::vector<std::uint32_t> number_of(model.nodes.size(), 0);
    scene.path_nodes.push_back({0, {}, no_id, 0});
    std::vector<std::uint32_t> stack;
    for (std::uint32_t parent = 0; parent < node_of.size(); ++parent) {
        const auto& below =
            node_of[parent] == the_scene ? model.roots : model.nodes[node_of[parent]].children;
        stack.assign(below.rbegin(), below.rend());
        while (!stack.empty()) {
            const std::uint32_t index = stack.back();
            const Node& node = model.nodes[index];
            stack.pop_back();
            const std::string& name = path_name_of(model, node);
            if (name.empty() && node.mesh == no_id) {
                stack.insert(stack.end(), node.children.rbegin(), node.children.rend());
                continue;
            }
            const bool placed = node.mesh != no_id && traceable[node.mesh];
            number_of[index] = static_cast<std::uint32_t>(node_of.size());
            node_of.push_back(index);
            scene.path_nodes.push_back(
                {parent, name, index, placed ? std::max(node.instancing.count, 1U) : 0});
        }
    }
    for (const std::uint32_t index : order) {
        const Node& node = model.nodes[index];
        if (node.mesh != no_id && traceable[node.mesh])
            scene.placed_nodes.push_back(number_of[index]);
    }
}

/// Reads camera nodes in node order, in the scene's space.
void read_cameras(const Model& model, MotionWriter& motion, SceneDescription& scene) {
    Oddities odd;  // named by the numbers that --camera takes
    for (const PlacedNode& entry : nodes_with(model, &Node::camera)) {
        const Node& node = model.nodes[entry.node];
        const std::optional<Transform> pose = camera_pose(entry.to_scene);
        const Camera& camera = model.cameras[node.camera];
        const std::string& name = node.name.empty() ? camera.name : node.name;
        const char* const fault = !pose                                       ? no_pose
                                  : scene.cameras.size() == scene_cameras_max ? "is one too many"
                                                                              : nullptr;
        if (fault != nullptr) {
            leave_out(scene, "cameras",
                      fmt::format("{}: its camera is left out, because it {}",
                                  label("node", entry.node, name), fault));
            continue;
        }
        if (!camera.fault.empty())
            odd.add(label("camera", scene.cameras.size(), name), camera.fault);
        motion.place_camera(static_cast<std::uint32_t>(scene.cameras.size()), entry.node);
        scene.cameras.push_back({name, *pose, camera.yfov, camera.aspect, camera.ymag});
    }
    odd.append_to(scene.warnings);
}

}  // namespace

Result<void> read_nodes(const Model& model, const ImportLimits& limits, MaskRules& rules,
                        SceneDescription& scene) {
    const std::vector<std::uint32_t> order = depth_first(model);
    if (auto done = check_instance_count(model, order, limits); !done) return done;

    std::vector<bool> used(model.meshes.size(), false);
    for (const std::uint32_t index : order) {
        if (model.nodes[index].mesh != no_id) used[model.nodes[index].mesh] = true;
    }
    MotionWriter motion(model, scene);
    auto meshes = read_meshes(model, used, limits, motion, scene);
    if (!meshes) return error_of(meshes);
    std::vector<bool> traceable;
    for (const ObjectDescription& mesh : *meshes)
        traceable.push_back(own_triangles(mesh) != 0 || !mesh.record_bounds.empty());
    for (const std::uint32_t index : order) {
        const Node& node = model.nodes[index];
        if (node.mesh != no_id && !traceable[node.mesh]) {
            scene.skipped["instances_without_triangles"] += std::max(node.instancing.count, 1U);
        }
    }
    scene.objects = std::move(*meshes);

    name_paths(model, order, traceable, scene);
    const auto masks = read_masks(model, order, rules, scene);
    if (!masks) return error_of(masks);

    const Sharing sharing = find_sharing(model, order, traceable, *masks);
    SceneWriter writer(model, sharing, traceable, *masks, motion, scene);
    if (auto done = writer.write(); !done) return done;
    read_cameras(model, motion, scene);
    read_lights(model, motion, scene);
    motion.finish();
    return {};
}

}  // namespace raynest::gltf
