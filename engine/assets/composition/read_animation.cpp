#include "engine/assets/composition/read_animation.h"

#include <span>

namespace raynest::composition {
namespace {

/// Returns the number of a word among the first `words` of an enumeration.
template <class Word, std::size_t N>
Word read_word(const Value& value, const std::array<std::string_view, N>& words) {
    const std::string text = value.text();
    const auto found = std::ranges::find(words, text);
    if (found == words.end()) value.refuse_it(fmt::format("is none of {}", fmt::join(words, ", ")));
    return static_cast<Word>(found - words.begin());
}

float read_time(const Value& value) {
    const double time = value.number();
    if (!(time >= 0 && time <= double{motion_seconds_max}))
        value.refuse_it("is no time from 0 to 1e6 seconds");
    return static_cast<float>(time);
}

/// Appends the numbers of a key.
void read_key(const Value& value, MotionPath path, std::vector<float>& values) {
    const auto add = [&](std::span<const double> numbers) {
        for (const double number : numbers) {
            const auto rounded = static_cast<float>(number);
            if (!std::isfinite(rounded)) value.refuse_it("does not fit a float");
            values.push_back(rounded);
        }
    };
    if (path == MotionPath::rotation)
        add(value.numbers<4>());
    else if (path == MotionPath::scale && !value.is_list())
        add(std::array{value.number(), value.number(), value.number()});
    else
        add(value.numbers<3>());
}

Channel read_channel(const Value& value) {
    constexpr std::array<std::string_view, 3> paths{"translation", "rotation", "scale"};
    constexpr std::array<std::string_view, 3> interpolations{"step", "linear", "cubic"};
    value.only({"instance", "path", "times", "values", "interpolation"});
    Channel channel;
    channel.place = value.place();
    channel.instance = value.at("instance").text();
    channel.path = read_word<MotionPath>(value.at("path"), paths);
    if (value.has("interpolation"))
        channel.interpolation = read_word<Interpolation>(value.at("interpolation"), interpolations);
    for (const Value& time : value.at("times").list()) {
        channel.times.push_back(read_time(time));
        const auto keys = channel.times.size();
        if (keys > 1 && !(channel.times[keys - 2] < channel.times[keys - 1]))
            time.refuse_it("is not behind the time before it");
    }
    const auto values = value.at("values").list();
    const std::size_t each = channel.interpolation == Interpolation::cubic ? 3 : 1;
    if (channel.times.empty() || values.size() != each * channel.times.size())
        value.refuse_it(
            fmt::format("has {} times and {} values: give at least one time, and {} "
                        "for each",
                        channel.times.size(), values.size(),
                        each == 1 ? "a value" : "a tangent, a value and a tangent"));
    for (std::size_t i = 0; i < values.size(); ++i) {
        read_key(values[i], channel.path, channel.values);
        const bool is_value = each == 1 || i % 3 == 1;
        const auto key =
            std::span(channel.values).last(channel.path == MotionPath::rotation ? 4 : 3);
        const auto is_zero = [](float number) { return number == 0; };
        if (is_value && channel.path == MotionPath::rotation && std::ranges::all_of(key, is_zero))
            values[i].refuse_it("is a quaternion of length 0");
        if (is_value && channel.path == MotionPath::scale && std::ranges::any_of(key, is_zero))
            values[i].refuse_it("is flat: a scale must not be 0");
    }
    return channel;
}

}  // namespace

Animation read_animation(const Value& value) {
    value.only({"name", "channels"});
    Animation animation;
    if (value.has("name")) animation.name = value.at("name").text();
    for (const Value& channel : value.at("channels").list())
        animation.channels.push_back(read_channel(channel));
    if (animation.channels.empty()) value.refuse_it("moves nothing: it has no channels");
    return animation;
}

}  // namespace raynest::composition
