#include "engine/assets/gltf/motion.h"

#include "engine/assets/gltf/precision.h"
#include "engine/geometry/ray.h"

#include <fmt/format.h>

#include <algorithm>

namespace raynest::gltf {
namespace {

/// The parent of each node where it is placed: the scene's roots have none, nor do nodes outside
/// the scene that nobody names (skins.cpp).
std::vector<std::uint32_t> parents_of(const Model& model) {
    std::vector<std::uint32_t> parents(model.nodes.size(), no_id);
    for (std::uint32_t i = 0; i < model.nodes.size(); ++i)
        for (const std::uint32_t child : model.nodes[i].children) parents[child] = i;
    for (const std::uint32_t root : model.roots) parents[root] = no_id;
    return parents;
}

}  // namespace

MotionWriter::MotionWriter(const Model& model, SceneDescription& scene)
    : model_(model),
      scene_(scene) {
    if (model.animations.empty()) return;
    parents_ = parents_of(model);
    numbers_.assign(model.nodes.size(), no_id);
    moves_.assign(model.nodes.size(), false);
    std::vector<std::uint32_t> stack;
    for (std::uint32_t i = 0; i < model.nodes.size(); ++i)
        if (parents_[i] == no_id) stack.push_back(i);
    while (!stack.empty()) {
        const std::uint32_t at = stack.back();
        stack.pop_back();
        const std::uint32_t parent = parents_[at];
        moves_[at] = model.nodes[at].is_animated || (parent != no_id && moves_[parent]);
        for (const std::uint32_t child : model.nodes[at].children)
            if (parents_[child] == at) stack.push_back(child);
    }
    deforms_.assign(model.meshes.size(), false);
    bool any = false;
    for (const Node& node : model.nodes) {
        if (node.mesh == no_id) continue;
        const bool by_joints =
            node.skin != no_id &&
            std::ranges::any_of(model.skins[node.skin].joints,
                                [&](std::uint32_t joint) { return moves_[joint]; });
        if (!by_joints && !node.has_moving_weights) continue;
        deforms_[node.mesh] = true;
        any = true;
    }
    if (any && scene.origin != WorldPoint{}) {
        deforms_.clear();
        scene.warnings.emplace_back(
            "vertices do not play in a scene with an origin; its nodes do. Load it without "
            "--origin");
    }
    tables_.floats = model.key_floats;
    tables_.samplers = model.samplers;
}

std::uint32_t MotionWriter::add_floats(std::span<const float> values) {
    const auto first = static_cast<std::uint32_t>(tables_.floats.size());
    tables_.floats.insert(tables_.floats.end(), values.begin(), values.end());
    return first;
}

std::uint32_t MotionWriter::number_of(std::uint32_t node) {
    std::vector<std::uint32_t> way;
    for (std::uint32_t at = node; at != no_id && numbers_[at] == no_id; at = parents_[at])
        way.push_back(at);
    for (; !way.empty(); way.pop_back()) {
        const Node& from = model_.nodes[way.back()];
        const std::uint32_t above = parents_[way.back()];
        MotionNode made;
        made.parent = above == no_id ? no_id : numbers_[above];
        made.has_trs = from.is_animated ? 1 : 0;
        made.trs = from.trs;
        if (!from.is_animated) made.local = from.local;
        // The parts of an outermost node are in the world, its matrix is in the scene (move_world).
        const bool is_moved = scene_.origin != WorldPoint{} || model_.up != UpAxis::y;
        if (from.is_animated && above == no_id && is_moved) {
            MotionNode world;
            world.local = world_to_scene(model_.up, scene_.origin);
            made.parent = static_cast<std::uint32_t>(tables_.nodes.size());
            tables_.nodes.push_back(world);
        }
        numbers_[way.back()] = static_cast<std::uint32_t>(tables_.nodes.size());
        tables_.nodes.push_back(made);
    }
    return numbers_[node];
}

void MotionWriter::begin_mesh(std::uint32_t mesh) {
    meshes_[mesh] = static_cast<std::uint32_t>(tables_.meshes.size());
    places_.emplace_back();
    MovedMesh& made = tables_.meshes.emplace_back();
    made.first_part = static_cast<std::uint32_t>(tables_.parts.size());
    const Mesh& from = model_.meshes[mesh];
    const Mesh& in_file = from.pose_of == no_id ? from : model_.meshes[from.pose_of];
    std::vector<float> weights = from.weights.empty() ? in_file.weights : from.weights;
    std::size_t targets = 0;
    for (const Primitive& primitive : in_file.primitives)
        targets = std::max(targets, primitive.targets.size());
    weights.resize(targets);
    made.first_weight = add_floats(weights);
    made.weight_count = static_cast<std::uint32_t>(targets);
}

void MotionWriter::begin_part() {
    MovedMesh& mesh = tables_.meshes.back();
    ++mesh.part_count;
    MovedPart& part = tables_.parts.emplace_back();
    part.first_target = static_cast<std::uint32_t>(tables_.targets.size());
    tables_.targets.resize(tables_.targets.size() + mesh.weight_count);
}

void MotionWriter::set_positions(std::span<const float> values) {
    tables_.parts.back().positions = add_floats(values);
}
void MotionWriter::set_normals(std::span<const float> values) {
    tables_.parts.back().normals = add_floats(values);
}
void MotionWriter::set_tangents(std::span<const float> values) {
    tables_.parts.back().tangents = add_floats(values);
}

void MotionWriter::set_target(std::size_t target, Morphed attribute,
                              std::span<const float> differences) {
    MovedTarget& made = tables_.targets[tables_.parts.back().first_target + target];
    if (attribute == morphed_position) made.positions = add_floats(differences);
    if (attribute == morphed_normal) made.normals = add_floats(differences);
    if (attribute == morphed_tangent) made.tangents = add_floats(differences);
}

void MotionWriter::set_influences(std::uint32_t count, std::span<const std::uint32_t> joints,
                                  std::span<const float> weights) {
    MovedPart& part = tables_.parts.back();
    part.influences = count;
    part.first_joint = static_cast<std::uint32_t>(tables_.joint_numbers.size());
    tables_.joint_numbers.insert(tables_.joint_numbers.end(), joints.begin(), joints.end());
    part.first_influence = add_floats(weights);
}

void MotionWriter::end_part(std::uint32_t vertices) {
    MovedPart& part = tables_.parts.back();
    part.vertices = vertices;
    if (vertices != 0) return;
    part.influences = 0;
    part.normals = part.tangents = no_id;
}

void MotionWriter::set_joints(std::uint32_t mesh, std::span<const Matrix> binds) {
    MovedMesh& made = tables_.meshes.back();
    if (made.joint_count != 0) return;
    std::vector<MotionJoint> joints;
    const Skin& skin = model_.skins[model_.meshes[mesh].skin];
    for (std::size_t i = 0; i < binds.size(); ++i)
        joints.push_back({number_of(skin.joints[i]), 0, binds[i]});
    made.first_joint = static_cast<std::uint32_t>(tables_.joints.size());
    made.joint_count = static_cast<std::uint32_t>(joints.size());
    tables_.joints.insert(tables_.joints.end(), joints.begin(), joints.end());
}

void MotionWriter::place(std::uint32_t outermost, std::uint32_t node, std::uint32_t object,
                         const Matrix& to_node) {
    if (const auto mesh = meshes_.find(object); mesh != meshes_.end())
        places_[mesh->second].push_back(outermost);
    // The joints place a skinned mesh, not its node.
    if (!moves(node) || (model_.nodes[node].skin != no_id && model_.nodes[node].mesh == object))
        return;
    tables_.instances.push_back({outermost, number_of(node), to_node});
}

void MotionWriter::place_camera(std::uint32_t camera, std::uint32_t node) {
    if (moves(node)) tables_.cameras.push_back({camera, number_of(node)});
}

void MotionWriter::place_light(std::uint32_t light, std::uint32_t node) {
    if (moves(node)) tables_.lights.push_back({light, number_of(node)});
}

void MotionWriter::finish() {
    if (moves_.empty()) return;
    // The build leaves singular instances out, so those behind them have smaller numbers.
    std::vector<std::uint32_t> numbers;
    std::uint32_t next = 0;
    for (const InstanceDescription& instance : scene_.objects[scene_.root].instances) {
        Transform inverse;
        numbers.push_back(invert(instance.transform, inverse) ? next++ : no_id);
    }
    std::size_t lost = 0;
    for (MovedInstance& moved : tables_.instances) moved.outermost = numbers[moved.outermost];
    lost += std::erase_if(tables_.instances, [](const auto& m) { return m.outermost == no_id; });
    for (std::size_t m = 0; m < places_.size(); ++m) {
        MovedMesh& mesh = tables_.meshes[m];
        mesh.first_place = static_cast<std::uint32_t>(tables_.places.size());
        for (const std::uint32_t place : places_[m])
            if (numbers[place] != no_id) tables_.places.push_back(numbers[place]);
        mesh.place_count = static_cast<std::uint32_t>(tables_.places.size()) - mesh.first_place;
    }
    if (lost != 0)
        scene_.warnings.push_back(
            fmt::format("{} animated placement{} never shown: {} scale is 0 in the file", lost,
                        lost == 1 ? " is" : "s are", lost == 1 ? "its" : "their"));
    // A node that is not numbered moves nothing of the scene.
    for (const Animation& from : model_.animations) {
        MotionAnimation made;
        made.name = static_cast<std::uint32_t>(tables_.names.size());
        tables_.names.insert(tables_.names.end(), from.name.begin(), from.name.end());
        tables_.names.push_back('\0');
        made.first_channel = static_cast<std::uint32_t>(tables_.channels.size());
        for (const Channel& channel : from.channels) {
            const MotionSampler& sampler = tables_.samplers[channel.sampler];
            made.seconds =
                std::max(made.seconds, tables_.floats[sampler.first_time + sampler.keys - 1]);
            std::uint32_t target = numbers_[channel.node];
            if (channel.path == MotionPath::weights) {
                const auto mesh = meshes_.find(model_.nodes[channel.node].mesh);
                target = mesh == meshes_.end() ? no_id : mesh->second;
                if (target != no_id && tables_.meshes[target].weight_count != sampler.width)
                    target = no_id;
            }
            if (target == no_id) continue;
            tables_.channels.push_back({channel.sampler, target, channel.path});
        }
        made.channel_count =
            static_cast<std::uint32_t>(tables_.channels.size()) - made.first_channel;
        tables_.animations.push_back(made);
    }
    if (tables_.floats.size() > motion_floats_max) {
        scene_.warnings.emplace_back("its animations are left out: they move too many vertices");
        return;
    }
    scene_.motion = motion_bytes(tables_);
}

}  // namespace raynest::gltf
