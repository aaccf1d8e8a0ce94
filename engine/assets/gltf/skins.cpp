#include "engine/assets/gltf/skins.h"

#include "engine/assets/input/messages.h"
#include "engine/math/finite.h"
#include "engine/scene/motion/skinning.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <tuple>

namespace raynest::gltf {
namespace {

/// JOINTS_n are 16-bit numbers.
constexpr std::size_t joints_max = 65536;

tl::unexpected<Error> refuse(const std::string& where, const std::string& why) {
    return fail(ErrorCode::scene_invalid, where + ' ' + why);
}

/// Returns node transforms in the scene's space, for every node of the file: joints may lie outside
/// the chosen scene.
std::vector<Matrix> node_transforms(const Model& model) {
    std::vector<Matrix> to_world;
    std::vector<bool> is_child(model.nodes.size(), false);
    for (const Node& node : model.nodes) {
        to_world.push_back(node.local);
        for (const std::uint32_t child : node.children) is_child[child] = true;
    }
    for (const std::uint32_t root : model.roots) is_child[root] = false;
    std::vector<std::uint32_t> stack;
    for (std::uint32_t i = 0; i < model.nodes.size(); ++i) {
        if (!is_child[i]) stack.push_back(i);
    }
    while (!stack.empty()) {
        const std::uint32_t parent = stack.back();
        stack.pop_back();
        for (const std::uint32_t child : model.nodes[parent].children) {
            if (!is_child[child]) continue;
            to_world[child] = multiply(to_world[parent], model.nodes[child].local);
            stack.push_back(child);
        }
    }
    return to_world;
}

bool is_weight(const Accessor& accessor) {
    return accessor.width == 4 && (accessor.component == Component::f32 ||
                                   (accessor.normalized && (accessor.component == Component::u8 ||
                                                            accessor.component == Component::u16)));
}

bool is_joint(const Accessor& accessor) {
    return accessor.width == 4 && !accessor.normalized &&
           (accessor.component == Component::u8 || accessor.component == Component::u16);
}

}  // namespace

void separate_poses(Model& model) {
    std::vector<bool> has_joints;
    for (const Mesh& mesh : model.meshes) {
        has_joints.push_back(std::any_of(mesh.primitives.begin(), mesh.primitives.end(),
                                         [](const Primitive& p) { return !p.joint_sets.empty(); }));
    }
    // Weights that move are those of one node.
    using Pose = std::tuple<std::uint32_t, std::uint32_t, std::vector<float>, const Node*>;
    std::map<Pose, std::uint32_t> poses;
    for (Node& node : model.nodes) {
        if (node.mesh == no_id || !has_joints[node.mesh]) node.skin = no_id;
        if (node.mesh == no_id) continue;
        if (node.weights == model.meshes[node.mesh].weights) node.weights.clear();
        if (node.skin == no_id && node.weights.empty() && !node.has_moving_weights) continue;
        const auto number = static_cast<std::uint32_t>(model.meshes.size());
        const auto [pose, is_new] = poses.try_emplace(
            {node.mesh, node.skin, node.weights, node.has_moving_weights ? &node : nullptr},
            number);
        if (is_new) {
            model.meshes.push_back(
                {model.meshes[node.mesh].name, {}, node.weights, node.mesh, node.skin});
        }
        node.mesh = pose->second;
    }
}

Result<void> Deformer::morph(const Deformed& vertices, Morphed attribute, std::size_t width,
                             std::vector<float>& values) {
    const Mesh& mesh = vertices.mesh;
    const bool own = !mesh.weights.empty() || mesh.pose_of == no_id;
    const std::vector<float>& weights = own ? mesh.weights : model_.meshes[mesh.pose_of].weights;
    const std::vector<MorphTarget>& targets = vertices.primitive.targets;
    const bool moves = vertices.motion != nullptr;
    const std::size_t count = moves ? targets.size() : std::min(targets.size(), weights.size());
    if (auto done = budget_.take_bytes(count * sizeof(float)); !done) return done;
    for (std::size_t t = 0; t < count; ++t) {
        const std::uint32_t index = targets[t][attribute];
        const float weight = t < weights.size() ? weights[t] : 0;
        if (index == no_id || (weight == 0 && !moves)) continue;
        const Accessor& accessor = model_.accessors[index];
        const bool allowed =
            accessor.width == width && accessor.component != Component::u32 &&
            (accessor.component == Component::f32 || accessor.normalized || model_.quantized);
        const auto differences = vertices.read(accessor, allowed, morphed_names[attribute]);
        if (!differences && weight == 0) continue;
        if (!differences) return error_of(differences);
        if (moves) vertices.motion->set_target(t, attribute, *differences);
        if (weight != 0) add_weighted(values, weight, differences->data());
    }
    return {};
}

Result<std::vector<float>> Deformer::inverse_bind_matrices(const Skin& skin) {
    const Accessor& accessor = model_.accessors[skin.inverse_bind];
    if (!accessor.fault.empty()) return fail(ErrorCode::scene_invalid, "needs " + accessor.fault);
    if (accessor.width != 16 || accessor.component != Component::f32) {
        return fail(ErrorCode::scene_invalid, "has inverseBindMatrices of the wrong type");
    }
    if (accessor.count < skin.joints.size()) {
        return fail(ErrorCode::scene_invalid,
                    fmt::format("has {} joints but {} inverseBindMatrices", skin.joints.size(),
                                accessor.count));
    }
    if (auto done = budget_.take_bytes(accessor.count * sizeof(float) * 16); !done) {
        return error_of(done);
    }
    return read_floats(accessor);
}

Result<std::span<const Matrix>> Deformer::joint_maps(std::uint32_t index) {
    std::vector<Matrix>& joints = joints_[index];
    if (!joints.empty()) return joints;
    const Skin& skin = model_.skins[index];
    const std::string where = label("skin", index, skin.name);
    if (skin.joints.empty()) return refuse(where, "has no joints");
    if (skin.joints.size() > joints_max) {
        return fail(ErrorCode::limit_exceeded,
                    fmt::format("{} has {} joints; at most {} are allowed", where,
                                skin.joints.size(), joints_max));
    }
    // Its maps, its binds, and the same of the motion.
    if (auto done = budget_.take_bytes(skin.joints.size() * 3 * sizeof(Matrix)); !done)
        return error_of(done);
    std::vector<float> inverse_bind;
    if (skin.inverse_bind != no_id) {
        auto values = inverse_bind_matrices(skin);
        if (!values) return blame(where, values.error());
        inverse_bind = std::move(*values);
    }
    if (to_world_.empty()) to_world_ = node_transforms(model_);
    for (const std::uint32_t node : skin.joints) {
        Matrix to_joint = identity_matrix;
        for (std::size_t i = 0; i < 12 && !inverse_bind.empty(); ++i) {
            to_joint[i] = inverse_bind[16 * joints.size() + i % 4 * 4 + i / 4];  // by columns
        }
        binds_[index].push_back(to_joint);
        joints.push_back(multiply(to_world_[node], to_joint));
        if (!is_finite(joints.back())) {
            return refuse(where, fmt::format("has a matrix that is not finite at joint {}",
                                             joints.size() - 1));
        }
    }
    return joints;
}

Result<void> Deformer::skin(const Deformed& vertices, GeometryDescription& geometry) {
    if (vertices.primitive.joint_sets.empty()) {
        return refuse(vertices.where, "has a skin but a primitive without JOINTS_0 and WEIGHTS_0");
    }
    const auto maps = joint_maps(vertices.mesh.skin);
    if (!maps) return error_of(maps);
    struct Set {
        std::vector<float> joints;
        std::vector<float> weights;
    };
    std::vector<Set> sets;
    for (const JointSet& set : vertices.primitive.joint_sets) {
        const Accessor& joint_accessor = model_.accessors[set.joints];
        const Accessor& weight_accessor = model_.accessors[set.weights];
        auto joints = vertices.read(joint_accessor, is_joint(joint_accessor), "JOINTS");
        if (!joints) return error_of(joints);
        auto weights = vertices.read(weight_accessor, is_weight(weight_accessor), "WEIGHTS");
        if (!weights) return error_of(weights);
        sets.push_back({std::move(*joints), std::move(*weights)});
    }

    // Those of each vertex together.
    std::vector<std::uint32_t> joints;
    std::vector<float> weights;
    std::uint64_t bad_weights = 0;
    std::uint64_t bad_joints = 0;
    const std::size_t count = geometry.positions.size();
    const std::size_t each = 4 * sets.size();
    if (auto done = budget_.take_bytes(2 * sizeof(float) * each * count); !done) return done;
    joints.reserve(each * count);
    weights.reserve(each * count);
    for (std::size_t v = 0; v < count; ++v) {
        bool has_weight = false;
        for (const Set& set : sets) {
            for (std::size_t i = 4 * v; i < 4 * v + 4; ++i) {
                const bool good = set.weights[i] >= 0 && std::isfinite(set.weights[i]);
                const bool known = set.joints[i] < static_cast<float>(maps->size());
                weights.push_back(good ? set.weights[i] : 0);
                joints.push_back(known ? static_cast<std::uint32_t>(set.joints[i]) : 0);
                bad_weights += good ? 0U : 1U;
                // A joint that moves nothing may be any number.
                bad_joints += !known && weights.back() > 0 ? 1U : 0U;
                has_weight = has_weight || weights.back() > 0;
            }
        }
        const bool follows_first = sets[0].joints[4 * v] < static_cast<float>(maps->size());
        bad_joints += !has_weight && !follows_first ? 1U : 0U;
    }
    if (bad_weights != 0) {
        return refuse(vertices.where, fmt::format("has {} skin weights that are negative or not "
                                                  "finite",
                                                  bad_weights));
    }
    if (bad_joints != 0) {
        return refuse(
            vertices.where,
            fmt::format("has {} vertices that name a joint beyond the {} of {}", bad_joints,
                        maps->size(),
                        label("skin", vertices.mesh.skin, model_.skins[vertices.mesh.skin].name)));
    }
    for (std::size_t v = 0; v < count; ++v)
        move_vertex(blend_joints(*maps, joints.data() + each * v, weights.data() + each * v, each),
                    geometry.positions[v],
                    geometry.normals.empty() ? nullptr : &geometry.normals[v],
                    geometry.tangents.empty() ? nullptr : &geometry.tangents[v]);
    if (vertices.motion != nullptr) {
        vertices.motion->set_joints(
            static_cast<std::uint32_t>(&vertices.mesh - model_.meshes.data()),
            binds_[vertices.mesh.skin]);
        vertices.motion->set_influences(static_cast<std::uint32_t>(each), joints, weights);
    }
    return {};
}

}  // namespace raynest::gltf
