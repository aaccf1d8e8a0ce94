#include "engine/scene/edits/pose.h"

#include "engine/scene/camera_pose.h"
#include "engine/scene/motion/skinning.h"

#include <fmt/format.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <deque>
#include <optional>
#include <string>
#include <vector>

namespace raynest {
namespace {

/// Rotations closer than this are blended straight: the arc between them has no direction.
constexpr double slerp_cosine_max = 1 - 1e-9;

Motion motion_of(const Snapshot& scene) {
    return checked_motion(scene.motion_bytes());
}

/// The two keys around a moment, and how far it is from the first to the second, 0 to 1.
struct Between {
    std::size_t from = 0;
    std::size_t to = 0;
    double share = 0;
    double seconds = 0;  ///< from key to key
};

Between keys_around(std::span<const float> times, double t) {
    const auto behind = std::ranges::upper_bound(times, t, {}, [](float x) { return double{x}; });
    const auto to = static_cast<std::size_t>(behind - times.begin());
    if (to == 0) return {};
    if (to == times.size()) return {to - 1, to - 1, 0, 0};
    const double before = times[to - 1], gap = double{times[to]} - before;
    return {to - 1, to, (t - before) / gap, gap};
}

/// Evaluates the channels of one animation at one moment.
class Sampling {
public:
    Sampling(const Motion& motion, double seconds) : motion_(motion), seconds_(seconds) {}

    /// Writes sampler.width numbers.
    void read(const MotionSampler& sampler, bool is_rotation, double* out) const {
        const Between keys =
            keys_around(motion_.floats.subspan(sampler.first_time, sampler.keys), seconds_);
        const std::size_t width = sampler.width;
        const bool cubic = sampler.interpolation == Interpolation::cubic;
        const float* const first = motion_.floats.data() + sampler.first_value;
        const auto value = [&](std::size_t key) {
            return first + (cubic ? 3 * key + 1 : key) * width;
        };
        const float* const a = value(keys.from);
        const float* const b = value(keys.to);
        const double u = keys.share;
        if (u == 0 || sampler.interpolation == Interpolation::step) {
            for (std::size_t i = 0; i < width; ++i) out[i] = a[i];
        } else if (cubic) {
            const float* const leaves = a + width;
            const float* const arrives = b - width;
            const double u2 = u * u, u3 = u2 * u;
            for (std::size_t i = 0; i < width; ++i)
                out[i] = (2 * u3 - 3 * u2 + 1) * double{a[i]} +
                         keys.seconds * (u3 - 2 * u2 + u) * double{leaves[i]} +
                         (3 * u2 - 2 * u3) * double{b[i]} +
                         keys.seconds * (u3 - u2) * double{arrives[i]};
        } else if (is_rotation) {
            turn(a, b, u, out);
        } else {
            for (std::size_t i = 0; i < width; ++i)
                out[i] = (1 - u) * double{a[i]} + u * double{b[i]};
        }
    }

private:
    /// The shorter way from one rotation to another (glTF 2.0, appendix C.4).
    static void turn(const float* a, const float* b, double u, double* out) {
        double cosine = 0;
        for (std::size_t i = 0; i < 4; ++i) cosine += double{a[i]} * double{b[i]};
        const double side = cosine < 0 ? -1 : 1;
        cosine = std::abs(cosine);
        double of_a = 1 - u, of_b = u;
        if (cosine < slerp_cosine_max) {
            const double angle = std::acos(cosine);
            of_a = std::sin((1 - u) * angle) / std::sin(angle);
            of_b = std::sin(u * angle) / std::sin(angle);
        }
        for (std::size_t i = 0; i < 4; ++i)
            out[i] = of_a * double{a[i]} + side * of_b * double{b[i]};
    }

    const Motion& motion_;
    const double seconds_;
};

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
          animation_(motion_.animations[moment.animation]),
          sampling_(motion_, moment.seconds) {}

    /// The vertices of the result belong to this.
    SceneChanges changes() {
        place_nodes();
        SceneChanges changes;
        for (const MovedInstance& moved : motion_.instances) {
            const Transform placed = round_affine(multiply(to_scene_[moved.node], moved.to_node));
            Transform inverse;
            if (invert(placed, inverse))
                changes.moves.push_back({moved.outermost, placed});
            else
                changes.masks.push_back({moved.outermost, 0});
        }
        for (const MovedCamera& moved : motion_.cameras)
            if (const auto at = camera_pose(to_scene_[moved.node]))
                changes.cameras.push_back({moved.camera, *at});
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
    void place_nodes() {
        std::vector<std::array<double, 10>> trs;
        for (const MotionNode& node : motion_.nodes) trs.push_back(node.trs);
        for (const MotionChannel& channel : channels()) {
            if (channel.path == MotionPath::weights) continue;
            const bool is_rotation = channel.path == MotionPath::rotation;
            const std::size_t at = is_rotation ? 3 : channel.path == MotionPath::scale ? 7 : 0;
            sampling_.read(motion_.samplers[channel.sampler], is_rotation,
                           trs[channel.target].data() + at);
        }
        for (std::size_t i = 0; i < motion_.nodes.size(); ++i) {
            const MotionNode& node = motion_.nodes[i];
            const Affine local = node.has_trs != 0
                                     ? from_trs(trs[i].data(), trs[i].data() + 3, trs[i].data() + 7)
                                     : node.local;
            to_scene_.push_back(node.parent == no_id ? local
                                                     : multiply(to_scene_[node.parent], local));
        }
    }

    [[nodiscard]] std::span<const MotionChannel> channels() const {
        return motion_.channels.subspan(animation_.first_channel, animation_.channel_count);
    }

    [[nodiscard]] std::vector<float> weights_of(std::uint32_t mesh) const {
        const MovedMesh& moved = motion_.meshes[mesh];
        const auto rest = motion_.floats.subspan(moved.first_weight, moved.weight_count);
        std::vector<float> weights(rest.begin(), rest.end());
        for (const MotionChannel& channel : channels()) {
            if (channel.path != MotionPath::weights || channel.target != mesh) continue;
            std::vector<double> exact(weights.size());
            sampling_.read(motion_.samplers[channel.sampler], false, exact.data());
            for (std::size_t i = 0; i < weights.size(); ++i)
                weights[i] = static_cast<float>(exact[i]);
        }
        return weights;
    }

    [[nodiscard]] PosedVertices deform(std::uint32_t index) const {
        const MovedMesh& mesh = motion_.meshes[index];
        const std::vector<float> weights = weights_of(index);
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
    const MotionAnimation& animation_;
    const Sampling sampling_;
    std::vector<Affine> to_scene_;  ///< by node
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
                                 name.empty() ? std::to_string(i) : '\'' + name + '\'');
        }
        return refuse(fmt::format("the scene has no animation '{}'; it has {}{}", animation, known,
                                  motion.animations.size() > listed_max ? ", ..." : ""));
    }
    const double most{motion.animations[index].seconds};
    if (!(seconds >= 0 && seconds <= most))
        return refuse(
            fmt::format("the animation runs from 0 to {} s; {} is outside it", most, seconds));
    return Moment{index, seconds};
}

std::uint64_t bytes_to_pose(const Snapshot& scene) {
    const Motion motion = motion_of(scene);
    std::uint64_t bytes = motion.nodes.size() * (sizeof(Affine) + sizeof(MotionNode::trs)) +
                          motion.instances.size() * 2 * sizeof(InstanceMove);
    for (const MovedPart& part : motion.parts)
        bytes += std::uint64_t{part.vertices} * (2 * sizeof(Vec3) + sizeof(Vec4));
    return bytes;
}

Result<std::shared_ptr<const Snapshot>> pose(const Snapshot& scene, const Moment& moment) {
    Poser poser(scene, moment);
    return edit_scene(scene, poser.changes());
}

}  // namespace raynest
