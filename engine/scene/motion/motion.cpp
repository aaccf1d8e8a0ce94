#include "engine/scene/motion/motion.h"

#include <cmath>
#include <cstring>
#include <type_traits>

namespace raynest {
namespace {

constexpr std::size_t list_count = 15;
constexpr std::size_t list_alignment = 8;
using Counts = std::array<std::uint64_t, list_count>;

constexpr std::size_t aligned(std::size_t bytes) {
    return (bytes + list_alignment - 1) / list_alignment * list_alignment;
}

template <class List>
using ElementOf = std::remove_cv_t<typename std::remove_reference_t<List>::value_type>;

tl::unexpected<Error> broken(const std::string& what) {
    return fail(ErrorCode::scene_invalid, "the scene arena is broken: its motion has " + what);
}

/// Points the lists at the bytes; false if these are not as long as they say.
bool find_lists(std::span<const std::byte> bytes, Motion& motion) {
    Counts counts;
    if (bytes.size() < sizeof counts) return false;
    std::memcpy(&counts, bytes.data(), sizeof counts);
    std::size_t at = sizeof counts;
    std::size_t which = 0;
    bool sound = true;
    motion.each([&](auto& list) {
        using Element = ElementOf<decltype(list)>;
        const std::uint64_t count = counts[which++];
        sound = sound && at <= bytes.size() && count <= (bytes.size() - at) / sizeof(Element);
        if (!sound) return;
        list = {reinterpret_cast<const Element*>(bytes.data() + at), count};
        at = aligned(at + count * sizeof(Element));
    });
    return sound && at == bytes.size();
}

bool fits(std::uint64_t first, std::uint64_t count, std::size_t size) {
    return first <= size && count <= size - first;
}

bool all_finite(std::span<const double> numbers) {
    return std::ranges::all_of(numbers, [](double x) { return std::isfinite(x); });
}

class Check {
public:
    Check(const Motion& motion, std::uint32_t outermost, std::uint32_t cameras,
          std::uint32_t lights)
        : motion_(motion),
          outermost_(outermost),
          cameras_(cameras),
          lights_(lights) {}

    Result<void> check() const {
        if (!std::ranges::all_of(motion_.floats, [](float x) { return std::isfinite(x); }))
            return broken("numbers that are not finite");
        if (!std::ranges::all_of(motion_.samplers, [&](const auto& s) { return is_sound(s); }))
            return broken("keys that are not there, or not in order");
        for (std::size_t i = 0; i < motion_.nodes.size(); ++i) {
            const MotionNode& node = motion_.nodes[i];
            if ((node.parent != no_id && node.parent >= i) || !all_finite(node.trs) ||
                !all_finite(node.local))
                return broken("nodes out of order, or not finite");
        }
        if (!std::ranges::all_of(motion_.meshes, [&](const auto& m) { return is_sound(m); }))
            return broken("vertices that are not there");
        if (!std::ranges::all_of(motion_.channels, [&](const auto& c) { return is_sound(c); }))
            return broken("channels without keys, or to nothing");
        const auto is_follower = [&](const auto& follower, std::uint32_t index, std::uint32_t of) {
            return index < of && follower.node < motion_.nodes.size();
        };
        for (const MovedInstance& moved : motion_.instances)
            if (!is_follower(moved, moved.outermost, outermost_) || !all_finite(moved.to_node))
                return broken("instances that the scene lacks");
        for (const MovedCamera& moved : motion_.cameras)
            if (!is_follower(moved, moved.camera, cameras_))
                return broken("cameras that the scene lacks");
        for (const MovedLight& moved : motion_.lights)
            if (!is_follower(moved, moved.light, lights_))
                return broken("lights that the scene lacks");
        for (const MotionJoint& joint : motion_.joints)
            if (joint.node >= motion_.nodes.size() || !all_finite(joint.bind))
                return broken("joints without nodes");
        for (const std::uint32_t place : motion_.places)
            if (place >= outermost_) return broken("placements that the scene lacks");
        if (!motion_.names.empty() && motion_.names.back() != '\0')
            return broken("a name without an end");
        for (const MotionAnimation& animation : motion_.animations)
            if (animation.name >= motion_.names.size() || !(animation.seconds >= 0) ||
                !(animation.seconds <= motion_seconds_max) ||
                !fits(animation.first_channel, animation.channel_count, motion_.channels.size()))
                return broken("an animation that is not there");
        return {};
    }

private:
    [[nodiscard]] bool has_floats(std::uint32_t first, std::uint64_t count) const {
        return fits(first, count, motion_.floats.size());
    }

    [[nodiscard]] bool is_sound(const MotionSampler& sampler) const {
        const std::uint64_t each = sampler.interpolation == Interpolation::cubic ? 3 : 1;
        if (sampler.interpolation > Interpolation::cubic || sampler.keys == 0 ||
            !has_floats(sampler.first_time, sampler.keys) ||
            !has_floats(sampler.first_value, each * sampler.keys * sampler.width))
            return false;
        const auto times = motion_.floats.subspan(sampler.first_time, sampler.keys);
        return times.front() >= 0 && std::ranges::is_sorted(times, std::less_equal());
    }

    [[nodiscard]] bool is_sound(const MotionChannel& channel) const {
        if (channel.sampler >= motion_.samplers.size()) return false;
        const std::uint32_t width = motion_.samplers[channel.sampler].width;
        if (channel.path == MotionPath::weights)
            return channel.target < motion_.meshes.size() &&
                   width == motion_.meshes[channel.target].weight_count;
        return channel.path < MotionPath::weights && channel.target < motion_.nodes.size() &&
               motion_.nodes[channel.target].has_trs != 0 &&
               width == (channel.path == MotionPath::rotation ? 4 : 3);
    }

    [[nodiscard]] bool is_sound(const MovedMesh& mesh) const {
        if (!fits(mesh.first_place, mesh.place_count, motion_.places.size()) ||
            !fits(mesh.first_part, mesh.part_count, motion_.parts.size()) ||
            !fits(mesh.first_joint, mesh.joint_count, motion_.joints.size()) ||
            !has_floats(mesh.first_weight, mesh.weight_count))
            return false;
        const auto parts = motion_.parts.subspan(mesh.first_part, mesh.part_count);
        return std::ranges::all_of(parts, [&](const auto& part) { return is_sound(part, mesh); });
    }

    [[nodiscard]] bool is_sound(const MovedPart& part, const MovedMesh& mesh) const {
        const std::uint64_t vertices = part.vertices;
        const auto is_run = [&](std::uint32_t first, std::uint64_t width) {
            return first == no_id || has_floats(first, width * vertices);
        };
        if (part.positions == no_id || !is_run(part.positions, 3) || !is_run(part.normals, 3) ||
            !is_run(part.tangents, 4) ||
            !fits(part.first_target, mesh.weight_count, motion_.targets.size()))
            return false;
        for (const MovedTarget& target :
             motion_.targets.subspan(part.first_target, mesh.weight_count))
            if (!is_run(target.positions, 3) || !is_run(target.normals, 3) ||
                !is_run(target.tangents, 3))
                return false;
        const std::uint64_t influences = vertices * part.influences;
        if (part.influences % 4 != 0 || (part.influences != 0 && mesh.joint_count == 0) ||
            !fits(part.first_joint, influences, motion_.joint_numbers.size()) ||
            !has_floats(part.first_influence, influences))
            return false;
        return std::ranges::all_of(motion_.joint_numbers.subspan(part.first_joint, influences),
                                   [&](std::uint32_t j) { return j < mesh.joint_count; });
    }

    const Motion& motion_;
    const std::uint32_t outermost_;
    const std::uint32_t cameras_;
    const std::uint32_t lights_;
};

}  // namespace

std::vector<std::byte> motion_bytes(MotionTables& tables) {
    Counts counts{};
    std::size_t size = sizeof counts;
    std::size_t which = 0;
    tables.each([&](auto& list) {
        counts[which++] = list.size();
        size = aligned(size + list.size() * sizeof(ElementOf<decltype(list)>));
    });
    std::vector<std::byte> bytes(size);
    std::memcpy(bytes.data(), &counts, sizeof counts);
    std::size_t at = sizeof counts;
    tables.each([&](auto& list) {
        const std::size_t length = list.size() * sizeof(ElementOf<decltype(list)>);
        if (length != 0) std::memcpy(bytes.data() + at, list.data(), length);
        at = aligned(at + length);
    });
    return bytes;
}

Result<Motion> read_motion(std::span<const std::byte> bytes, std::uint32_t outermost,
                           std::uint32_t cameras, std::uint32_t lights) {
    Motion motion;
    if (bytes.empty()) return motion;
    if (!find_lists(bytes, motion)) return broken("another length than its tables");
    if (motion.floats.size() > motion_floats_max ||
        motion.animations.size() > motion_animations_max)
        return broken("more than it may have");
    if (auto sound = Check(motion, outermost, cameras, lights).check(); !sound)
        return tl::unexpected(sound.error());
    return motion;
}

Motion checked_motion(std::span<const std::byte> bytes) {
    Motion motion;
    return find_lists(bytes, motion) ? motion : Motion{};
}

std::vector<std::byte> motion_without(std::span<const std::byte> bytes,
                                      std::span<const std::uint32_t> removed) {
    Motion motion;
    if (!find_lists(bytes, motion)) return {};
    MotionTables tables;
    std::vector<std::span<const std::byte>> from;
    motion.each([&](auto& list) { from.push_back(std::as_bytes(list)); });
    std::size_t which = 0;
    tables.each([&](auto& list) {
        using Element = ElementOf<decltype(list)>;
        const auto* const first = reinterpret_cast<const Element*>(from[which].data());
        list.assign(first, first + from[which].size() / sizeof(Element));
        ++which;
    });
    // An instance's number less those that are gone before it; no_id: it is gone itself.
    const auto renumber = [&](std::uint32_t& outermost) {
        const auto at = std::ranges::lower_bound(removed, outermost);
        if (at != removed.end() && *at == outermost)
            outermost = no_id;
        else
            outermost -= static_cast<std::uint32_t>(at - removed.begin());
    };
    for (MovedInstance& moved : tables.instances) renumber(moved.outermost);
    std::erase_if(tables.instances, [](const auto& moved) { return moved.outermost == no_id; });
    std::vector<std::uint32_t> places;
    for (MovedMesh& mesh : tables.meshes) {
        const auto first = static_cast<std::uint32_t>(places.size());
        for (std::uint32_t i = 0; i < mesh.place_count; ++i) {
            std::uint32_t place = tables.places[mesh.first_place + i];
            renumber(place);
            if (place != no_id) places.push_back(place);
        }
        mesh.first_place = first;
        mesh.place_count = static_cast<std::uint32_t>(places.size()) - first;
    }
    tables.places = std::move(places);
    return motion_bytes(tables);
}

}  // namespace raynest
