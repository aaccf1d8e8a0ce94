#include "engine/assets/builtin/play.h"

#include <cmath>
#include <numbers>

namespace raynest {
namespace {

constexpr float keys_per_period = 12;

}  // namespace

std::uint32_t Play::add_floats(const std::vector<float>& values) {
    const auto first = static_cast<std::uint32_t>(tables_.floats.size());
    tables_.floats.insert(tables_.floats.end(), values.begin(), values.end());
    return first;
}

std::uint32_t Play::add_node() {
    tables_.nodes.emplace_back().has_trs = 1;
    return static_cast<std::uint32_t>(tables_.nodes.size() - 1);
}

void Play::add_channel(std::uint32_t node, MotionPath path, const std::vector<float>& times,
                       const std::vector<float>& values) {
    const auto keys = static_cast<std::uint32_t>(times.size());
    const auto width = static_cast<std::uint32_t>(values.size()) / keys;
    const std::uint32_t first_time = add_floats(times);
    tables_.channels.push_back({static_cast<std::uint32_t>(tables_.samplers.size()), node, path});
    tables_.samplers.push_back(
        {first_time, keys, add_floats(values), width, Interpolation::linear});
}

std::uint32_t Play::add_drive(const Vec3& way) {
    const std::uint32_t node = add_node();
    add_channel(node, MotionPath::translation, {0, seconds_}, {0, 0, 0, way.x, way.y, way.z});
    return node;
}

std::uint32_t Play::add_sway(const Vec3& foot, const Vec3& axis, float angle, float period,
                             float phase) {
    const std::uint32_t node = add_node();
    for (int i = 0; i < 3; ++i)
        tables_.nodes[node].trs[static_cast<std::size_t>(i)] = static_cast<double>(foot[i]);
    const auto keys = static_cast<std::size_t>(std::ceil(seconds_ / period * keys_per_period)) + 1;
    std::vector<float> times, turns;
    for (std::size_t k = 0; k < keys; ++k) {
        const float t = seconds_ * static_cast<float>(k) / static_cast<float>(keys - 1);
        const float half =
            0.5F * angle * std::sin(2 * std::numbers::pi_v<float> * (t / period + phase));
        times.push_back(t);
        const Vec3 turn = std::sin(half) * axis;
        turns.insert(turns.end(), {turn.x, turn.y, turn.z, std::cos(half)});
    }
    add_channel(node, MotionPath::rotation, times, turns);
    return node;
}

void Play::follow(std::uint32_t node, std::uint32_t outermost, const Transform& rest) {
    Affine to_node = affine_of(rest);
    for (std::size_t i = 0; i < 3; ++i) to_node[4 * i + 3] -= tables_.nodes[node].trs[i];
    tables_.instances.push_back({outermost, node, to_node});
}

void Play::follow_with_camera(std::uint32_t node, std::uint32_t camera, const Transform& rest) {
    MotionNode seat;
    seat.parent = node;
    seat.local = affine_of(rest);
    tables_.cameras.push_back({camera, static_cast<std::uint32_t>(tables_.nodes.size())});
    tables_.nodes.push_back(seat);
}

std::vector<std::byte> Play::bytes() {
    MotionAnimation animation;
    animation.channel_count = static_cast<std::uint32_t>(tables_.channels.size());
    animation.seconds = seconds_;
    tables_.animations = {animation};
    tables_.names = {'\0'};
    return motion_bytes(tables_);
}

}  // namespace raynest
