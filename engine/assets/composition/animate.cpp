#include "engine/assets/composition/animate.h"

#include "engine/assets/input/messages.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <set>
#include <utility>

namespace raynest::composition {
namespace {

Affine affine_of(const Matrix& matrix) {
    Affine made{};
    for (int i = 0; i < 12; ++i) made[static_cast<std::size_t>(i)] = matrix[i % 4][i / 4];
    return made;
}

std::uint32_t size_of(const auto& list) {
    return static_cast<std::uint32_t>(list.size());
}

std::uint32_t add_floats(const std::vector<float>& values, MotionTables& tables) {
    const std::uint32_t first = size_of(tables.floats);
    tables.floats.insert(tables.floats.end(), values.begin(), values.end());
    return first;
}

}  // namespace

void Animator::add(const Places& places, std::size_t count, const Matrix& to_group) {
    auto& known = places_[places.name];
    for (std::size_t i = 0; i < count; ++i)
        known.push_back(
            {count_++, places.parts.has_value(), places.parts.value_or(PoseParts()), to_group});
}

Result<const Animator::Place*> Animator::find(const Channel& channel) const {
    const auto refused = [&](std::string_view why) {
        return fail(ErrorCode::scene_invalid, fmt::format("{} moves '{}', {}", channel.place,
                                                          one_line(channel.instance), why));
    };
    std::string name = channel.instance;
    std::size_t number = 0;
    bool is_numbered = false;
    if (const auto mark = name.rfind('#'); !places_.contains(name) && mark != std::string::npos) {
        const char* const end = name.data() + name.size();
        const auto [read, error] = std::from_chars(name.data() + mark + 1, end, number);
        is_numbered = error == std::errc() && read == end;
        if (is_numbered) name.resize(mark);
    }
    const auto known = places_.find(name);
    if (known == places_.end() || number >= known->second.size())
        return refused("which is none of its instances");
    if (!is_numbered && known->second.size() > 1)
        return refused("which stands at several places: name one of them, such as NAME#0");
    const Place& place = known->second[number];
    if (!place.is_moving)
        return refused(
            "which a matrix places: keys take the place of its 'translation', 'rotation' and "
            "'scale'");
    return &place;
}

Result<std::vector<std::byte>> Animator::tables(const std::vector<Animation>& animations,
                                                const WorldPoint& origin) const {
    if (animations.empty()) return std::vector<std::byte>();
    if (animations.size() > motion_animations_max)
        return fail(ErrorCode::limit_exceeded,
                    fmt::format("has {} animations; at most {} are allowed", animations.size(),
                                motion_animations_max));
    MotionTables tables;
    std::map<std::uint32_t, std::uint32_t> nodes;  // by outermost instance
    const std::uint32_t world = origin == WorldPoint{} ? no_id : 0;
    if (world == 0) {
        MotionNode& node = tables.nodes.emplace_back();
        node.local = affine_of(translation_by({-origin[0], -origin[1], -origin[2]}));
    }
    const auto node_of = [&](const Place& place) {
        const auto [known, is_new] = nodes.try_emplace(place.outermost, size_of(tables.nodes));
        if (!is_new) return known->second;
        MotionNode& node = tables.nodes.emplace_back();
        node.parent = world;
        node.has_trs = 1;
        const PoseParts& parts = place.parts;
        for (int i = 0; i < 3; ++i) node.trs[static_cast<std::size_t>(i)] = parts.translation[i];
        std::ranges::copy(parts.rotation, node.trs.begin() + 3);
        for (int i = 0; i < 3; ++i) node.trs[static_cast<std::size_t>(7 + i)] = parts.scale[i];
        tables.instances.push_back({place.outermost, known->second, affine_of(place.to_group)});
        return known->second;
    };
    for (const Animation& animation : animations) {
        MotionAnimation& made = tables.animations.emplace_back();
        made.name = size_of(tables.names);
        const std::string name = one_line(animation.name);
        tables.names.insert(tables.names.end(), name.begin(), name.end());
        tables.names.push_back('\0');
        made.first_channel = size_of(tables.channels);
        made.channel_count = size_of(animation.channels);
        std::set<std::pair<std::uint32_t, MotionPath>> moved;
        for (const Channel& channel : animation.channels) {
            const auto place = find(channel);
            if (!place) return tl::unexpected(place.error());
            if (!moved.emplace((*place)->outermost, channel.path).second)
                return fail(
                    ErrorCode::scene_invalid,
                    fmt::format("{} moves '{}' by the path of a channel before it: give one "
                                "channel all its keys",
                                channel.place, one_line(channel.instance)));
            tables.channels.push_back({size_of(tables.samplers), node_of(**place), channel.path});
            const std::uint32_t first_time = add_floats(channel.times, tables);
            tables.samplers.push_back(
                {first_time, size_of(channel.times), add_floats(channel.values, tables),
                 channel.path == MotionPath::rotation ? 4U : 3U, channel.interpolation});
            made.seconds = std::max(made.seconds, channel.times.back());
        }
    }
    return motion_bytes(tables);
}

}  // namespace raynest::composition
