#include "engine/scene/edits/speed.h"

#include "engine/scene/motion/sampling.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <map>
#include <string>
#include <utility>
#include <vector>

namespace raynest {
namespace {

/// Moments from one key to the next at which speeds are measured, for each node that turns between
/// a part and the scene: what these turns add up to changes the faster the more they are.
constexpr std::uint32_t pieces = 8;
constexpr std::uint32_t turns_max = 32;
/// A spline of rotations may speed up and slow down several times from key to key.
constexpr std::uint32_t turns_of_spline = 4;

/// Bounds by how much the linear part of a map stretches; 1 for a turn.
double stretch(const Affine& m) {
    const auto column = [&](std::size_t c) { return glm::dvec3(m[c], m[4 + c], m[8 + c]); };
    double most = 0;
    for (std::size_t i = 0; i < 3; ++i) {
        double sum = 0;
        for (std::size_t j = 0; j < 3; ++j) sum += std::abs(glm::dot(column(i), column(j)));
        most = std::max(most, sum);
    }
    return std::sqrt(most);
}

}  // namespace

class SpeedMeter {
public:
    SpeedMeter(const Snapshot& scene, std::uint32_t animation)
        : motion_(checked_motion(scene.motion_bytes())),
          animation_(motion_.animations[animation]),
          placed_(scene.view().instance_infos +
                  scene.view().objects[scene.view().root].first_instance) {
        const SceneView& view = scene.view();
        const std::uint32_t first = view.objects[view.root].first_instance;
        std::map<std::uint32_t, std::uint32_t> mesh_at;
        for (std::uint32_t m = 0; m < motion_.meshes.size(); ++m)
            for (const std::uint32_t place : motion_.places.subspan(motion_.meshes[m].first_place,
                                                                    motion_.meshes[m].place_count))
                mesh_at.emplace(place, m);
        const std::vector<Affine> at_rest = MotionSampling::nodes_at_rest(motion_);
        for (const MovedInstance& moved : motion_.instances) {
            const std::uint32_t object = view.instances[first + moved.outermost].object;
            const auto change = change_of(multiply(at_rest[moved.node], moved.to_node),
                                          view.instance_infos[first + moved.outermost].to_parent);
            const auto mesh = mesh_at.find(moved.outermost);
            const Follower follower{moved.node, moved.to_node, view.objects[object].bounds,
                                    mesh == mesh_at.end() ? no_id : mesh->second,
                                    change.value_or(identity_affine)};
            follow(follower);
            if (follower.mesh != no_id) carried_.insert_or_assign(moved.outermost, follower);
        }
        for (std::uint32_t m = 0; m < motion_.meshes.size(); ++m) add(m);
        pieces_ = pieces * turns();
    }

    Result<void> between(double from, double to) {
        if (!(from < to)) return {};
        const auto too_many = [&](const std::string& what) {
            return fail(
                ErrorCode::limit_exceeded,
                fmt::format("between {:.6g} and {:.6g} s the animation has {}; ask for less "
                            "of that time at once",
                            from, to, what));
        };
        std::vector<double> keys{from, to};
        if (!add_keys(from, to, keys))
            return too_many(fmt::format("more than {} keys", SpeedSearch::keys_max));
        const std::uint64_t looks =
            motion_.nodes.size() + 8 * followers_.size() + motion_.places.size();
        if (looks * keys.size() * pieces_ > SpeedSearch::looks_max)
            return too_many(
                fmt::format("{} keys of {} moving nodes", keys.size(), motion_.nodes.size()));
        keys_ = std::move(keys);
        return {};
    }

    bool go_on(const std::function<bool()>& pause) {
        while (next_ + 1 < keys_.size()) {
            look(piece_);
            if (++piece_ > pieces_) piece_ = 0, ++next_;
            if (!std::isfinite(most_)) next_ = keys_.size();
            if (pause()) break;
        }
        return next_ + 1 >= keys_.size();
    }
    [[nodiscard]] double fastest() const { return most_; }

private:
    /// A box that follows a node, and what happens to it besides.
    struct Follower {
        std::uint32_t node = 0;
        Affine to_node = identity_affine;
        Box box;
        std::uint32_t mesh = no_id;       ///< whose vertices move besides
        Affine change = identity_affine;  ///< in the scene
    };
    /// At the end of a piece of the curves from one key to the next; of piece 0 at its beginning.
    void look(std::uint32_t piece) {
        const double begin = keys_[next_], end = keys_[next_ + 1];
        const double seconds = begin + (end - begin) * piece / pieces_;
        const double keys_at = piece == pieces_ ? std::nextafter(end, begin) : seconds;
        constexpr double step = MotionSampling::rate_step;
        const double speed = farthest({motion_, animation_, seconds - step, keys_at},
                                      {motion_, animation_, seconds + step, keys_at}) /
                             (2 * step);
        if (!std::isfinite(speed)) {
            most_ = std::numeric_limits<double>::infinity();
            return;
        }
        if (piece == 0) before_ = last_ = std::numeric_limits<double>::infinity();
        most_ = std::max(most_, speed);
        // A peak between the moments, by the parabola through three of them.
        if (const double bend = before_ - 2 * last_ + speed; last_ > before_ && last_ > speed)
            most_ = std::max(most_, last_ - (speed - before_) * (speed - before_) / (8 * bend));
        before_ = std::exchange(last_, speed);
    }

    /// The most nodes that turn, one within the other.
    [[nodiscard]] std::uint32_t turns() const {
        std::vector<std::uint32_t> turning(motion_.nodes.size());
        for (const MotionChannel& channel :
             motion_.channels.subspan(animation_.first_channel, animation_.channel_count))
            if (channel.path == MotionPath::rotation)
                turning[channel.target] =
                    motion_.samplers[channel.sampler].interpolation == Interpolation::cubic
                        ? turns_of_spline
                        : 1;
        std::uint32_t most = 1;
        for (std::size_t i = 0; i < turning.size(); ++i) {
            if (motion_.nodes[i].parent != no_id) turning[i] += turning[motion_.nodes[i].parent];
            most = std::max(most, turning[i]);
        }
        return std::min(most, turns_max);
    }

    [[nodiscard]] Affine placed_at(std::uint32_t outermost) const {
        return affine_of(placed_[outermost].to_parent);
    }

    void follow(const Follower& follower) {
        if (!follower.box.is_empty()) followers_.push_back(follower);
    }

    void add(std::uint32_t index) {
        const MovedMesh& mesh = motion_.meshes[index];
        std::vector<Box> boxes(mesh.joint_count);
        std::vector<double>& reach = reaches_.emplace_back(mesh.weight_count);
        const float* const floats = motion_.floats.data();
        for (const MovedPart& part : motion_.parts.subspan(mesh.first_part, mesh.part_count)) {
            for (std::uint32_t v = 0; v < part.vertices; ++v) {
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
        Affine widest = identity_affine;  // the widest map that places the mesh
        for (const std::uint32_t place : motion_.places.subspan(mesh.first_place, mesh.place_count))
            if (const Affine at = placed_at(place); stretch(at) > stretch(widest)) widest = at;
        for (std::uint32_t j = 0; j < mesh.joint_count; ++j) {
            const MotionJoint& joint = motion_.joints[mesh.first_joint + j];
            follow({joint.node, joint.bind, boxes[j], index, widest});
        }
    }

    /// Adds the keys between two times, each once. Returns false if they are too many.
    [[nodiscard]] bool add_keys(double from, double to, std::vector<double>& keys) const {
        const auto once = [&] {
            std::ranges::sort(keys);
            keys.erase(std::ranges::unique(keys).begin(), keys.end());
            return keys.size() <= SpeedSearch::keys_max;
        };
        std::vector<bool> seen(motion_.samplers.size());
        for (const MotionChannel& channel :
             motion_.channels.subspan(animation_.first_channel, animation_.channel_count)) {
            if (seen[channel.sampler]) continue;
            seen[channel.sampler] = true;
            const MotionSampler& sampler = motion_.samplers[channel.sampler];
            const auto times = motion_.floats.subspan(sampler.first_time, sampler.keys);
            const auto first = std::ranges::upper_bound(times, from);
            const auto last = std::ranges::lower_bound(times, to);
            if (first >= last) continue;
            if (static_cast<std::uint64_t>(last - first) > SpeedSearch::keys_max) return false;
            keys.insert(keys.end(), first, last);
            // Channels mostly share their times.
            if (keys.size() > 4 * SpeedSearch::keys_max && !once()) return false;
        }
        return once();
    }

    /// The longest way that anything takes between two moments.
    double farthest(const MotionSampling& first, const MotionSampling& last) const {
        const std::vector<Affine> before = first.nodes(), after = last.nodes();
        double most = 0;
        std::vector<double> of_mesh(motion_.meshes.size());
        for (const Follower& each : followers_) {
            const Affine a = multiply(before[each.node], each.to_node);
            const Affine b = multiply(after[each.node], each.to_node);
            for (int corner = 0; corner < 8; ++corner) {
                const glm::dvec3 p(corner & 1 ? each.box.upper.x : each.box.lower.x,
                                   corner & 2 ? each.box.upper.y : each.box.lower.y,
                                   corner & 4 ? each.box.upper.z : each.box.lower.z);
                const double way =
                    glm::length(map_vector(each.change, map_point(b, p) - map_point(a, p)));
                if (!std::isfinite(way)) return std::numeric_limits<double>::infinity();
                most = std::max(most, way);
                if (each.mesh != no_id) of_mesh[each.mesh] = std::max(of_mesh[each.mesh], way);
            }
        }
        for (std::uint32_t m = 0; m < motion_.meshes.size(); ++m)
            if (motion_.meshes[m].weight_count != 0)
                most = std::max(most, of_mesh[m] + bent(m, first, last, after));
        return most;
    }

    /// The longest way by which targets move a vertex, stretched as its joints or its node do.
    double bent(std::uint32_t m, const MotionSampling& first, const MotionSampling& last,
                const std::vector<Affine>& nodes) const {
        const MovedMesh& mesh = motion_.meshes[m];
        const std::vector<double> before = first.exact_weights(m), after = last.exact_weights(m);
        double way = 0;
        for (std::size_t t = 0; t < before.size(); ++t)
            way += std::abs(after[t] - before[t]) * reaches_[m][t];
        if (way == 0) return 0;
        double of_joints = mesh.joint_count == 0 ? 1 : 0, of_places = 0;
        for (const MotionJoint& joint : motion_.joints.subspan(mesh.first_joint, mesh.joint_count))
            of_joints = std::max(of_joints, stretch(multiply(nodes[joint.node], joint.bind)));
        for (const std::uint32_t place :
             motion_.places.subspan(mesh.first_place, mesh.place_count)) {
            const auto carried = carried_.find(place);
            of_places = std::max(
                of_places,
                stretch(carried == carried_.end()
                            ? placed_at(place)
                            : multiply(carried->second.change, multiply(nodes[carried->second.node],
                                                                        carried->second.to_node))));
        }
        return way * of_joints * of_places;
    }

    const Motion motion_;
    const MotionAnimation& animation_;
    const InstanceInfo* const placed_;  ///< the outermost instances
    std::vector<Follower> followers_;
    std::vector<std::vector<double>> reaches_;   ///< [mesh][target]: how far it moves a vertex
    std::map<std::uint32_t, Follower> carried_;  ///< by outermost instance
    std::uint32_t pieces_ = pieces;
    std::vector<double> keys_;
    std::size_t next_ = 0;          ///< index in keys_
    std::uint32_t piece_ = 0;       ///< from there to the next key
    double before_ = 0, last_ = 0;  ///< speeds at the two moments before
    double most_ = 0;
};

SpeedSearch::SpeedSearch(std::unique_ptr<SpeedMeter> meter) : meter_(std::move(meter)) {}
SpeedSearch::SpeedSearch(SpeedSearch&&) noexcept = default;
SpeedSearch& SpeedSearch::operator=(SpeedSearch&&) noexcept = default;
SpeedSearch::~SpeedSearch() = default;

Result<SpeedSearch> SpeedSearch::begin(const Snapshot& scene, std::uint32_t animation, double from,
                                       double to) {
    auto meter = std::make_unique<SpeedMeter>(scene, animation);
    if (auto begun = meter->between(from, to); !begun) return tl::unexpected(begun.error());
    return SpeedSearch(std::move(meter));
}

bool SpeedSearch::go_on(const std::function<bool()>& pause) {
    return meter_->go_on(pause);
}

double SpeedSearch::fastest() const {
    return meter_->fastest();
}

Result<std::vector<double>> jumps_between(const Snapshot& scene, std::uint32_t animation,
                                          double from, double to) {
    const Motion motion = checked_motion(scene.motion_bytes());
    const MotionAnimation& played = motion.animations[animation];
    // Nodes of which something that rays can meet hangs.
    std::vector<bool> carries(motion.nodes.size());
    for (const MovedInstance& moved : motion.instances) carries[moved.node] = true;
    for (const MotionJoint& joint : motion.joints) carries[joint.node] = true;
    for (std::size_t i = motion.nodes.size(); i-- > 0;)
        if (carries[i] && motion.nodes[i].parent != no_id) carries[motion.nodes[i].parent] = true;
    std::vector<bool> seen(motion.samplers.size());  // which channels mostly share
    std::vector<double> jumps;
    const auto once = [&] {
        std::ranges::sort(jumps);
        jumps.erase(std::ranges::unique(jumps).begin(), jumps.end());
        return jumps.size() <= SpeedSearch::keys_max;
    };
    const auto too_many = [] {
        return fail(ErrorCode::limit_exceeded,
                    fmt::format("parts jump more than {} times; ask for less of that time at once",
                                SpeedSearch::keys_max));
    };
    for (const MotionChannel& channel :
         motion.channels.subspan(played.first_channel, played.channel_count)) {
        const MotionSampler& sampler = motion.samplers[channel.sampler];
        if (sampler.interpolation != Interpolation::step || seen[channel.sampler] ||
            (channel.path != MotionPath::weights && !carries[channel.target]))
            continue;
        seen[channel.sampler] = true;
        const auto times = motion.floats.subspan(sampler.first_time, sampler.keys);
        const float* const values = motion.floats.data() + sampler.first_value;
        for (auto at = std::ranges::upper_bound(times, from);
             at != times.end() && double{*at} <= to; ++at) {
            const auto key = static_cast<std::size_t>(at - times.begin());
            const float* const now = values + key * sampler.width;
            // The first key's value holds before it, too.
            if (key == 0 || std::equal(now, now + sampler.width, now - sampler.width)) continue;
            jumps.push_back(double{*at});
            // Channels mostly share their times.
            if (jumps.size() > 4 * SpeedSearch::keys_max && !once()) return too_many();
        }
    }
    if (!once()) return too_many();
    return jumps;
}

}  // namespace raynest
