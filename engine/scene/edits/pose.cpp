#include "engine/scene/edits/pose.h"

#include "engine/math/finite.h"
#include "engine/scene/camera_pose.h"
#include "engine/scene/motion/sampling.h"
#include "engine/scene/motion/skinning.h"

#include <fmt/format.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <charconv>
#include <deque>

namespace raynest {
namespace {

Motion motion_of(const Snapshot& scene) {
    return checked_motion(scene.motion_bytes());
}

/// The vertices of a mesh at a moment, those of its parts one behind the other.
struct PosedVertices {
    std::vector<Vec3> positions;
    std::vector<Vec3> normals;   ///< empty or as many
    std::vector<Vec4> tangents;  ///< empty or as many
};

class Poser {
public:
    Poser(const Snapshot& scene, const Moment& moment)
        : motion_(motion_of(scene)),
          sampling_(motion_, motion_.animations[moment.animation], moment.seconds),
          to_scene_(sampling_.nodes()),
          at_rest_(MotionSampling::nodes_at_rest(motion_)),
          placed_(scene.view().instance_infos +
                  scene.view().objects[scene.view().root].first_instance),
          lights_(scene.shading().lights) {}

    /// The vertices of the result belong to this.
    SceneChanges changes() {
        SceneChanges changes;
        for (const MovedInstance& moved : motion_.instances) {
            Affine exact = multiply(to_scene_[moved.node], moved.to_node);
            if (const auto change = change_of(multiply(at_rest_[moved.node], moved.to_node),
                                              placed_[moved.outermost].to_parent)) {
                if (to_scene_[moved.node] == at_rest_[moved.node]) continue;
                exact = multiply(*change, exact);
            }
            const Transform placed = round_affine(exact);
            Transform inverse;
            if (invert(placed, inverse))
                changes.moves.push_back({moved.outermost, placed});
            else
                changes.masks.push_back({moved.outermost, 0});
        }
        for (const MovedCamera& moved : motion_.cameras)
            if (const auto at = camera_pose(to_scene_[moved.node]))
                changes.cameras.push_back({moved.camera, *at});
        for (const MovedLight& moved : motion_.lights) {
            const auto at = camera_pose(to_scene_[moved.node]);
            const Vec3 place = place_of(at ? *at : round_affine(to_scene_[moved.node]));
            // One whose scale is 0 has a place, but no direction: it keeps its own.
            if (is_finite(place))
                changes.lights.push_back(
                    {moved.light, place, at ? ahead_of(*at) : lights_[moved.light].direction});
        }
        for (std::uint32_t m = 0; m < motion_.meshes.size(); ++m) {
            const MovedMesh& mesh = motion_.meshes[m];
            if (mesh.place_count == 0) continue;
            const PosedVertices& vertices = vertices_.emplace_back(deform(m));
            for (const std::uint32_t place :
                 motion_.places.subspan(mesh.first_place, mesh.place_count))
                changes.deformed.push_back(
                    {place, vertices.positions, vertices.normals, vertices.tangents});
        }
        return changes;
    }

private:
    [[nodiscard]] PosedVertices deform(std::uint32_t index) const {
        const MovedMesh& mesh = motion_.meshes[index];
        const std::vector<float> weights = sampling_.weights(index);
        std::vector<Affine> maps;
        for (const MotionJoint& joint : motion_.joints.subspan(mesh.first_joint, mesh.joint_count))
            maps.push_back(multiply(to_scene_[joint.node], joint.bind));
        const auto parts = motion_.parts.subspan(mesh.first_part, mesh.part_count);
        const auto has = [&](std::uint32_t MovedPart::*what) {
            return std::ranges::any_of(parts, [&](const MovedPart& p) { return p.*what != no_id; });
        };
        std::size_t count = 0;
        for (const MovedPart& part : parts) count += part.vertices;
        PosedVertices made;
        made.positions.resize(count);
        if (has(&MovedPart::normals)) made.normals.resize(count);
        if (has(&MovedPart::tangents)) made.tangents.resize(count);
        std::size_t first = 0;
        for (const MovedPart& part : parts) {
            tbb::parallel_for(tbb::blocked_range<std::size_t>(0, part.vertices, 4096),
                              [&](const tbb::blocked_range<std::size_t>& some) {
                                  for (std::size_t v = some.begin(); v != some.end(); ++v)
                                      move(part, weights, maps, v, made, first + v);
                              });
            first += part.vertices;
        }
        return made;
    }

    /// Writes vertex v of a part as vertex `out`.
    void move(const MovedPart& part, std::span<const float> weights, std::span<const Affine> maps,
              std::size_t v, PosedVertices& made, std::size_t out) const {
        const float* const floats = motion_.floats.data();
        Vec3& position = made.positions[out];
        std::copy_n(floats + part.positions + 3 * v, 3, &position.x);
        for (std::size_t t = 0; t < weights.size(); ++t) {
            const std::uint32_t add = motion_.targets[part.first_target + t].positions;
            if (add != no_id && weights[t] != 0)
                add_weighted({&position.x, 3}, weights[t], floats + add + 3 * v);
        }
        Vec3* normal = nullptr;
        if (part.normals != no_id) {
            normal = &made.normals[out];
            std::copy_n(floats + part.normals + 3 * v, 3, &normal->x);
            *normal = morphed(part, &MovedTarget::normals, weights, v, *normal);
        }
        Vec4* tangent = nullptr;
        if (part.tangents != no_id) {
            tangent = &made.tangents[out];
            std::copy_n(floats + part.tangents + 4 * v, 4, &tangent->x);
            *tangent =
                Vec4(morphed(part, &MovedTarget::tangents, weights, v, Vec3(*tangent)), tangent->w);
        }
        if (part.influences == 0) return;
        const std::size_t at = v * part.influences;
        move_vertex(blend_joints(maps, motion_.joint_numbers.data() + part.first_joint + at,
                                 floats + part.first_influence + at, part.influences),
                    position, normal, tangent);
    }

    [[nodiscard]] Vec3 morphed(const MovedPart& part, std::uint32_t MovedTarget::*what,
                               std::span<const float> weights, std::size_t v,
                               const Vec3& rest) const {
        std::array<float, 3> sum{};
        bool any = false;
        for (std::size_t t = 0; t < weights.size(); ++t) {
            const std::uint32_t add = motion_.targets[part.first_target + t].*what;
            if (add == no_id) continue;
            any = true;
            if (weights[t] != 0) add_weighted(sum, weights[t], motion_.floats.data() + add + 3 * v);
        }
        return any ? bent(rest, sum.data()) : rest;
    }

    const Motion motion_;
    const MotionSampling sampling_;
    const std::vector<Affine> to_scene_;  ///< by node
    const std::vector<Affine> at_rest_;   ///< likewise
    const InstanceInfo* const placed_;    ///< outermost instances, as edits have left them
    const LightRecord* const lights_;
    std::deque<PosedVertices> vertices_;
};

}  // namespace

std::vector<SceneAnimation> animations_of(const Snapshot& scene, std::size_t most) {
    const Motion motion = motion_of(scene);
    std::vector<SceneAnimation> animations;
    for (const MotionAnimation& each :
         motion.animations.first(std::min(most, motion.animations.size())))
        animations.push_back({name_of(motion, each), double{each.seconds}});
    return animations;
}

Result<Moment> find_moment(const Snapshot& scene, std::string_view animation, double seconds) {
    const auto refuse = [](std::string why) {
        return fail(ErrorCode::field_invalid, std::move(why));
    };
    const Motion motion = motion_of(scene);
    if (motion.animations.empty())
        return refuse("the scene has no animation, so it has no other time");
    std::uint32_t index = 0;
    if (!animation.empty()) {
        while (index < motion.animations.size() &&
               !is_named(motion, motion.animations[index], animation))
            ++index;
        std::uint32_t number = 0;
        const char* const end = animation.data() + animation.size();
        const auto [stop, bad] = std::from_chars(animation.data(), end, number);
        if (index == motion.animations.size() && bad == std::errc() && stop == end) index = number;
    }
    if (index >= motion.animations.size()) {
        constexpr std::size_t listed_max = 8;
        std::string known;
        for (std::size_t i = 0; i < std::min(motion.animations.size(), listed_max); ++i) {
            const std::string name = name_of(motion, motion.animations[i]);
            known += fmt::format("{}{}", i == 0 ? "" : ", ",
                                 name.empty() ? fmt::format("number {}", i) : '\'' + name + '\'');
        }
        return refuse(fmt::format("the scene has no animation '{}'; it has {}{}", animation, known,
                                  motion.animations.size() > listed_max ? ", ..." : ""));
    }
    const double most{motion.animations[index].seconds};
    // Keys are float32: 0.7 s in a file is a little less.
    if (static_cast<float>(seconds) == motion.animations[index].seconds) seconds = most;
    if (!(seconds >= 0 && seconds <= most))
        return refuse(
            fmt::format("the animation runs from 0 to {} s; {} is outside it", most, seconds));
    return Moment{index, seconds};
}

std::uint64_t bytes_to_pose(const Snapshot& scene) {
    const Motion motion = motion_of(scene);
    std::uint64_t bytes = motion.nodes.size() * (2 * sizeof(Affine) + sizeof(MotionNode::trs)) +
                          motion.instances.size() * 2 * sizeof(InstanceMove);
    for (const MovedPart& part : motion.parts)
        bytes += std::uint64_t{part.vertices} * (2 * sizeof(Vec3) + sizeof(Vec4));
    return bytes;
}

Result<std::shared_ptr<const Snapshot>> pose(const Snapshot& scene, const Moment& moment,
                                             const EditGuard& guard) {
    if (auto room = guard.allows(bytes_to_pose(scene)); !room) return tl::unexpected(room.error());
    Poser poser(scene, moment);
    SceneChanges changes = poser.changes();
    changes.is_last = true;
    auto posed = edit_scene(scene, changes, nullptr, guard);
    if (!posed) return posed;
    return Snapshot::framed_as(scene, std::move(*posed));
}

}  // namespace raynest
