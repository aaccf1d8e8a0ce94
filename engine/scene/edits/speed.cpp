#include "engine/scene/edits/speed.h"

#include "engine/scene/motion/sampling.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <span>
#include <vector>

namespace raynest {
namespace {

/// Moments from one key to the next at which speeds are measured: an arc of a quarter turn is
/// longer than its chords by less than 2 in 1000.
constexpr int pieces = 8;

/// A box that follows a node.
struct Follower {
    std::uint32_t node = 0;
    Affine to_node = identity_affine;
    Box box;
};

glm::dvec3 mapped(const Affine& m, const glm::dvec3& p) {
    return {m[0] * p.x + m[1] * p.y + m[2] * p.z + m[3],
            m[4] * p.x + m[5] * p.y + m[6] * p.z + m[7],
            m[8] * p.x + m[9] * p.y + m[10] * p.z + m[11]};
}

/// The most that the linear part of a map stretches by.
double stretch(const Affine& m) {
    double sum = 0;
    for (std::size_t i = 0; i < m.size(); ++i) sum += i % 4 == 3 ? 0 : m[i] * m[i];
    return std::sqrt(sum);
}

class SpeedMeter {
public:
    SpeedMeter(const Snapshot& scene, std::uint32_t animation, const std::function<bool()>& stop)
        : motion_(checked_motion(scene.motion_bytes())),
          animation_(motion_.animations[animation]),
          stop_(stop) {
        const SceneView& view = scene.view();
        const std::uint32_t first = view.objects[view.root].first_instance;
        for (const MovedInstance& moved : motion_.instances) {
            const std::uint32_t object = view.instances[first + moved.outermost].object;
            follow({moved.node, moved.to_node, view.objects[object].bounds});
        }
        for (const MovedMesh& mesh : motion_.meshes) add(mesh);
    }

    double fastest(double from, double to) const {
        if (!(from < to)) return 0;
        const std::vector<double> times = moments(from, to);
        double most = 0;
        for (std::size_t i = 1; i < times.size() && !stop_(); ++i) {
            // Just before the end: there a STEP channel jumps.
            const double end = std::nextafter(times[i], times[i - 1]);
            if (!(end > times[i - 1])) continue;
            const double far = farthest(times[i - 1], end);
            const double speed = far / (end - times[i - 1]);
            if (!std::isfinite(speed)) return std::numeric_limits<double>::infinity();
            most = std::max(most, speed);
        }
        return stop_() ? 0 : most;
    }

private:
    void follow(const Follower& follower) {
        if (!follower.box.is_empty()) followers_.push_back(follower);
    }

    void add(const MovedMesh& mesh) {
        std::vector<Box> boxes(mesh.joint_count);
        std::vector<double>& reach = reaches_.emplace_back(mesh.weight_count);
        const float* const floats = motion_.floats.data();
        for (const MovedPart& part : motion_.parts.subspan(mesh.first_part, mesh.part_count)) {
            for (std::uint32_t v = 0; v < part.vertices; ++v) {
                if (v % 4096 == 0 && stop_()) return;
                const float* const p = floats + part.positions + 3 * v;
                for (std::uint32_t i = 0; i < part.influences; ++i) {
                    const std::size_t at = std::size_t{v} * part.influences + i;
                    if (i != 0 && floats[part.first_influence + at] == 0) continue;
                    boxes[motion_.joint_numbers[part.first_joint + at]].extend({p[0], p[1], p[2]});
                }
                for (std::uint32_t t = 0; t < mesh.weight_count; ++t) {
                    const std::uint32_t by = motion_.targets[part.first_target + t].positions;
                    if (by == no_id) continue;
                    const float* const d = floats + by + 3 * v;
                    reach[t] = std::max(reach[t], glm::length(glm::dvec3(d[0], d[1], d[2])));
                }
            }
        }
        for (std::uint32_t j = 0; j < mesh.joint_count; ++j) {
            const MotionJoint& joint = motion_.joints[mesh.first_joint + j];
            follow({joint.node, joint.bind, boxes[j]});
        }
    }

    /// Keys between two times, and some moments between those.
    std::vector<double> moments(double from, double to) const {
        std::vector<double> keys{from, to};
        const auto once = [&] {
            std::ranges::sort(keys);
            keys.erase(std::ranges::unique(keys).begin(), keys.end());
        };
        std::size_t most = 1 << 16;  // channels mostly share their times
        for (const MotionChannel& channel :
             motion_.channels.subspan(animation_.first_channel, animation_.channel_count)) {
            const MotionSampler& sampler = motion_.samplers[channel.sampler];
            const auto times = motion_.floats.subspan(sampler.first_time, sampler.keys);
            for (const float time : times)
                if (double{time} > from && double{time} < to) keys.push_back(double{time});
            if (keys.size() <= most) continue;
            once();
            most = std::max(most, 2 * keys.size());
        }
        once();
        std::vector<double> all;
        for (std::size_t i = 0; i + 1 < keys.size(); ++i)
            for (int k = 0; k < pieces; ++k)
                all.push_back(keys[i] + (keys[i + 1] - keys[i]) * k / pieces);
        all.push_back(keys.back());
        return all;
    }

    /// The longest way that anything takes between two moments.
    double farthest(double begin, double end) const {
        const MotionSampling first(motion_, animation_, begin), last(motion_, animation_, end);
        const std::vector<Affine> before = first.nodes(), after = last.nodes();
        double most = 0;
        for (const Follower& each : followers_) {
            const Affine a = multiply(before[each.node], each.to_node);
            const Affine b = multiply(after[each.node], each.to_node);
            for (int corner = 0; corner < 8; ++corner) {
                const glm::dvec3 p(corner & 1 ? each.box.upper.x : each.box.lower.x,
                                   corner & 2 ? each.box.upper.y : each.box.lower.y,
                                   corner & 4 ? each.box.upper.z : each.box.lower.z);
                const double way = glm::length(mapped(b, p) - mapped(a, p));
                if (!std::isfinite(way)) return std::numeric_limits<double>::infinity();
                most = std::max(most, way);
            }
        }
        for (std::uint32_t m = 0; m < motion_.meshes.size(); ++m)
            if (motion_.meshes[m].weight_count != 0)
                most = std::max(most, bent(m, first, last, after));
        return most;
    }

    /// The longest way by which targets move a vertex, stretched as its joints or its node do.
    double bent(std::uint32_t m, const MotionSampling& first, const MotionSampling& last,
                const std::vector<Affine>& nodes) const {
        const MovedMesh& mesh = motion_.meshes[m];
        const std::vector<float> before = first.weights(m), after = last.weights(m);
        double way = 0;
        for (std::size_t t = 0; t < before.size(); ++t)
            way += std::abs(double{after[t]} - double{before[t]}) * reaches_[m][t];
        if (way == 0) return 0;
        double most = 0;
        for (const MotionJoint& joint : motion_.joints.subspan(mesh.first_joint, mesh.joint_count))
            most = std::max(most, stretch(multiply(nodes[joint.node], joint.bind)));
        for (const std::uint32_t place : motion_.places.subspan(mesh.first_place, mesh.place_count))
            for (const MovedInstance& moved : motion_.instances)
                if (moved.outermost == place)
                    most = std::max(most, stretch(multiply(nodes[moved.node], moved.to_node)));
        return way * (most > 0 ? most : 1);
    }

    const Motion motion_;
    const MotionAnimation& animation_;
    const std::function<bool()>& stop_;
    std::vector<Follower> followers_;
    std::vector<std::vector<double>> reaches_;  ///< [mesh][target]: how far it moves a vertex
};

}  // namespace

double fastest_speed(const Snapshot& scene, std::uint32_t animation, double from, double to,
                     const std::function<bool()>& stop) {
    return SpeedMeter(scene, animation, stop).fastest(from, to);
}

}  // namespace raynest
