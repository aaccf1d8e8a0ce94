#include "engine/assets/gltf/skins.h"

#include "engine/assets/input/messages.h"

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

bool is_finite(const Matrix& matrix) {
    return std::all_of(matrix.begin(), matrix.end(), [](double x) { return std::isfinite(x); });
}

/// Moves vertex v by a map that its weights have blended.
///
/// The cofactors of a map are its inverse transpose times its determinant: they exist for a map
/// that flattens, too. Where a map mirrors, corners wind the other way round, and shading turns the
/// normal and the tangent of the side that it sees: so both change their sign here.
void move_vertex(const Matrix& map, std::size_t v, GeometryDescription& geometry) {
    const auto column = [&](std::size_t c) { return glm::dvec3(map[c], map[4 + c], map[8 + c]); };
    const glm::dvec3 x = column(0), y = column(1), z = column(2);
    const auto linear = [&](const glm::dvec3& p) { return x * p.x + y * p.y + z * p.z; };
    geometry.positions[v] = Vec3(linear(glm::dvec3(geometry.positions[v])) + column(3));
    if (!geometry.normals.empty()) {
        const Vec3 n = geometry.normals[v];
        geometry.normals[v] = unit_vector(static_cast<double>(n.x) * glm::cross(y, z) +
                                          static_cast<double>(n.y) * glm::cross(z, x) +
                                          static_cast<double>(n.z) * glm::cross(x, y));
    }
    if (!geometry.tangents.empty()) {
        const double side = glm::dot(glm::cross(x, y), z) < 0 ? -1 : 1;
        Vec4& t = geometry.tangents[v];
        t = Vec4(unit_vector(side * linear(glm::dvec3(t))), t.w);
    }
}

}  // namespace

void separate_poses(Model& model) {
    std::vector<bool> has_joints;
    for (const Mesh& mesh : model.meshes) {
        has_joints.push_back(std::any_of(mesh.primitives.begin(), mesh.primitives.end(),
                                         [](const Primitive& p) { return !p.joint_sets.empty(); }));
    }
    std::map<std::tuple<std::uint32_t, std::uint32_t, std::vector<float>>, std::uint32_t> poses;
    for (Node& node : model.nodes) {
        if (node.mesh == no_id || !has_joints[node.mesh]) node.skin = no_id;
        if (node.mesh == no_id) continue;
        if (node.weights == model.meshes[node.mesh].weights) node.weights.clear();
        if (node.skin == no_id && node.weights.empty()) continue;
        const auto number = static_cast<std::uint32_t>(model.meshes.size());
        const auto [pose, is_new] = poses.try_emplace({node.mesh, node.skin, node.weights}, number);
        if (is_new) {
            model.meshes.push_back(
                {model.meshes[node.mesh].name, {}, node.weights, node.mesh, node.skin});
        }
        node.mesh = pose->second;
    }
}

Vec3 unit_vector(const glm::dvec3& v) {
    const double length = glm::length(v);
    return length > 0 && std::isfinite(length) ? Vec3(v / length) : Vec3(0);
}

Result<void> Deformer::morph(const Deformed& vertices, Morphed attribute, std::size_t width,
                             std::vector<float>& values) {
    const Mesh& mesh = vertices.mesh;
    const bool own = !mesh.weights.empty() || mesh.pose_of == no_id;
    const std::vector<float>& weights = own ? mesh.weights : model_.meshes[mesh.pose_of].weights;
    const std::vector<MorphTarget>& targets = vertices.primitive.targets;
    const std::size_t count = std::min(targets.size(), weights.size());
    if (auto done = budget_.take_bytes(count * sizeof(float)); !done) return done;
    for (std::size_t t = 0; t < count; ++t) {
        const std::uint32_t index = targets[t][attribute];
        if (index == no_id || weights[t] == 0) continue;
        const Accessor& accessor = model_.accessors[index];
        const bool allowed =
            accessor.width == width && accessor.component != Component::u32 &&
            (accessor.component == Component::f32 || accessor.normalized || model_.quantized);
        const auto differences = vertices.read(accessor, allowed, morphed_names[attribute]);
        if (!differences) return error_of(differences);
        for (std::size_t i = 0; i < values.size(); ++i) values[i] += weights[t] * (*differences)[i];
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
        joints.push_back(multiply(to_world_[node], to_joint));
        if (!is_finite(joints.back())) {
            return refuse(where, fmt::format("has a matrix that is not finite at joint {}",
                                             joints.size() - 1));
        }
    }
    return joints;
}

// Weights are divided by their sum, as in three.js and Blender: glTF requires sums of 1, and an
// error of 1/255 would move a vertex by that share of its distance from the scene's origin. A
// vertex whose weights are all 0 follows its first joint, as in three.js.
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

    std::uint64_t bad_weights = 0;
    std::uint64_t bad_joints = 0;
    for (std::size_t v = 0; v < geometry.positions.size(); ++v) {
        Matrix blended{};
        double total = 0;
        const auto follow = [&](float joint, double weight) {
            bad_joints += joint < static_cast<float>(maps->size()) ? 0U : 1U;
            if (!(joint < static_cast<float>(maps->size()))) return;
            const Matrix& m = (*maps)[static_cast<std::size_t>(joint)];
            for (std::size_t i = 0; i < blended.size(); ++i) blended[i] += weight * m[i];
            total += weight;
        };
        for (const Set& set : sets) {
            for (std::size_t i = 4 * v; i < 4 * v + 4; ++i) {
                const float weight = set.weights[i];
                const bool good = weight >= 0 && std::isfinite(weight);
                bad_weights += good ? 0U : 1U;
                if (good && weight > 0) follow(set.joints[i], weight);
            }
        }
        if (total == 0) follow(sets[0].joints[4 * v], 1);
        for (double& x : blended) x /= total;
        move_vertex(blended, v, geometry);
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
    return {};
}

}  // namespace raynest::gltf
