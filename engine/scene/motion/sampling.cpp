#include "engine/scene/motion/sampling.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

namespace raynest {
namespace {

/// Rotations closer than this are blended straight: the arc between them has no direction.
constexpr double slerp_cosine_max = 1 - 1e-9;

/// The two keys around a moment, and how far another one is from the first to the second.
struct Between {
    std::size_t from = 0;
    std::size_t to = 0;
    double share = 0;
    double seconds = 0;  ///< from key to key
};

Between keys_around(std::span<const float> times, double moment, double t) {
    const auto behind =
        std::ranges::upper_bound(times, moment, {}, [](float x) { return double{x}; });
    const auto to = static_cast<std::size_t>(behind - times.begin());
    if (to == 0) return {};
    if (to == times.size()) return {to - 1, to - 1, 0, 0};
    const double before = times[to - 1], gap = double{times[to]} - before;
    return {to - 1, to, (t - before) / gap, gap};
}

/// The shorter way from one rotation to another (glTF 2.0, appendix C.4).
void turn(const float* a, const float* b, double u, double* out) {
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
    for (std::size_t i = 0; i < 4; ++i) out[i] = of_a * double{a[i]} + side * of_b * double{b[i]};
}

}  // namespace

void MotionSampling::read(const MotionSampler& sampler, bool is_rotation, double* out) const {
    const Between keys =
        keys_around(motion_.floats.subspan(sampler.first_time, sampler.keys), keys_at_, seconds_);
    const std::size_t width = sampler.width;
    const bool cubic = sampler.interpolation == Interpolation::cubic;
    const float* const first = motion_.floats.data() + sampler.first_value;
    const auto value = [&](std::size_t key) { return first + (cubic ? 3 * key + 1 : key) * width; };
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
        for (std::size_t i = 0; i < width; ++i) out[i] = (1 - u) * double{a[i]} + u * double{b[i]};
    }
}

std::vector<Affine> MotionSampling::nodes() const {
    std::vector<std::array<double, 10>> trs;
    trs.reserve(motion_.nodes.size());
    for (const MotionNode& node : motion_.nodes) trs.push_back(node.trs);
    for (const MotionChannel& channel : channels()) {
        if (channel.path == MotionPath::weights) continue;
        const bool is_rotation = channel.path == MotionPath::rotation;
        const std::size_t at = is_rotation ? 3 : channel.path == MotionPath::scale ? 7 : 0;
        read(motion_.samplers[channel.sampler], is_rotation, trs[channel.target].data() + at);
    }
    std::vector<Affine> to_scene;
    to_scene.reserve(motion_.nodes.size());
    for (std::size_t i = 0; i < motion_.nodes.size(); ++i) {
        const MotionNode& node = motion_.nodes[i];
        const Affine local = node.has_trs != 0
                                 ? from_trs(trs[i].data(), trs[i].data() + 3, trs[i].data() + 7)
                                 : node.local;
        to_scene.push_back(node.parent == no_id ? local : multiply(to_scene[node.parent], local));
    }
    return to_scene;
}

std::vector<float> MotionSampling::weights(std::uint32_t mesh) const {
    const std::vector<double> exact = exact_weights(mesh);
    std::vector<float> weights(exact.size());
    for (std::size_t i = 0; i < weights.size(); ++i) weights[i] = static_cast<float>(exact[i]);
    return weights;
}

std::vector<double> MotionSampling::exact_weights(std::uint32_t mesh) const {
    const MovedMesh& moved = motion_.meshes[mesh];
    const auto rest = motion_.floats.subspan(moved.first_weight, moved.weight_count);
    std::vector<double> weights(rest.begin(), rest.end());
    for (const MotionChannel& channel : channels())
        if (channel.path == MotionPath::weights && channel.target == mesh)
            read(motion_.samplers[channel.sampler], false, weights.data());
    return weights;
}

}  // namespace raynest
