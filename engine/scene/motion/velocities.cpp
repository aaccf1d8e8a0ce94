#include "engine/scene/motion/velocities.h"

#include "engine/scene/motion/sampling.h"

#include <cmath>
#include <span>

namespace raynest {
namespace {

constexpr double half_span = MotionSampling::rate_step;

Affine difference(const Affine& before, const Affine& after) {
    Affine rate;
    for (std::size_t i = 0; i < rate.size(); ++i)
        rate[i] = (after[i] - before[i]) / (2 * half_span);
    return rate;
}

glm::dvec3 column(const Affine& map, std::size_t c) {
    return {map[c], map[4 + c], map[8 + c]};
}

}  // namespace

Velocities::Velocities(const Motion& motion, const MotionAnimation& animation, double seconds,
                       const InstanceInfo* placed)
    : motion_(motion) {
    const double keys_at =
        seconds >= double{animation.seconds} ? std::nextafter(seconds, 0) : seconds;
    const MotionSampling now(motion, animation, seconds, keys_at);
    const MotionSampling before(motion, animation, seconds - half_span, keys_at);
    const MotionSampling after(motion, animation, seconds + half_span, keys_at);
    const std::vector<Affine> maps = now.nodes();
    std::vector<Affine> rates = before.nodes();
    {
        const std::vector<Affine> ends = after.nodes();
        for (std::size_t i = 0; i < rates.size(); ++i) rates[i] = difference(rates[i], ends[i]);
    }
    carried_.reserve(motion.instances.size());
    for (const MovedInstance& moved : motion.instances) {
        Affine map = multiply(maps[moved.node], moved.to_node);
        Affine rate = multiply(rates[moved.node], moved.to_node);
        if (auto change = change_of(map, placed[moved.outermost].to_parent)) {
            map = multiply(*change, map);
            for (const std::size_t i : {3U, 7U, 11U}) (*change)[i] = 0;
            rate = multiply(*change, rate);
        }
        if (const auto back = invert(map))
            carried_.push_back(
                {moved.outermost, multiply(rate, *back), column(map, 3), column(rate, 3)});
    }
    std::ranges::stable_sort(carried_, {}, &Carried::outermost);
    for (std::uint32_t m = 0; m < motion.meshes.size(); ++m) {
        const MovedMesh& mesh = motion.meshes[m];
        if (mesh.place_count == 0) continue;
        Bent bent{.record = &mesh,
                  .maps = {},
                  .map_rates = {},
                  .weights = now.exact_weights(m),
                  .weight_rates = before.exact_weights(m)};
        const std::vector<double> ends = after.exact_weights(m);
        for (std::size_t t = 0; t < ends.size(); ++t)
            bent.weight_rates[t] = (ends[t] - bent.weight_rates[t]) / (2 * half_span);
        for (const MotionJoint& joint : motion.joints.subspan(mesh.first_joint, mesh.joint_count)) {
            bent.maps.push_back(multiply(maps[joint.node], joint.bind));
            bent.map_rates.push_back(multiply(rates[joint.node], joint.bind));
        }
        for (const std::uint32_t place : motion.places.subspan(mesh.first_place, mesh.place_count))
            places_.push_back({place, static_cast<std::uint32_t>(meshes_.size())});
        meshes_.push_back(std::move(bent));
    }
    std::ranges::sort(places_, {}, &Place::outermost);
}

std::uint64_t Velocities::bytes_for(const Motion& motion) {
    std::uint64_t bytes =
        sizeof(Velocities) + motion.nodes.size() * (3 * sizeof(Affine) + sizeof(MotionNode::trs)) +
        motion.instances.size() * sizeof(Carried) + motion.meshes.size() * sizeof(Bent) +
        motion.places.size() * 2 * sizeof(Place);
    for (const MovedMesh& mesh : motion.meshes)
        bytes += 4 * (mesh.joint_count * sizeof(Affine) + mesh.weight_count * sizeof(double));
    return bytes;
}

}  // namespace raynest
