#include "server/requests/words/setting_types.h"

#include "protocol/limits.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <optional>
#include <span>
#include <utility>

namespace raynest::server::setting {
namespace {

constexpr protocol::Limits limits;

tl::unexpected<protocol::Error> misshapen(std::string_view text, const std::string& shape) {
    constexpr std::size_t shown = 64;
    std::string message("'");
    message.append(text.substr(0, shown)).append(text.size() > shown ? "..." : "");
    return refuse(Code::invalid_field, message.append("' is not ").append(shape));
}

std::vector<std::string_view> split(std::string_view text, char separator) {
    std::vector<std::string_view> parts;
    for (std::size_t at = 0; at <= text.size();) {
        const std::size_t end = std::min(text.find(separator, at), text.size());
        parts.push_back(text.substr(at, end - at));
        at = end + 1;
    }
    return parts;
}

/// Parses a number that takes up the whole text; accepts infinity, not NaN.
template <class Value>
std::optional<Value> number(std::string_view text) {
    if (text.starts_with('+')) text.remove_prefix(1);
    Value value{};
    const char* const last = text.data() + text.size();
    const auto [end, error] = std::from_chars(text.data(), last, value);
    if (error != std::errc{} || end != last) return std::nullopt;
    if constexpr (std::is_floating_point_v<Value>)
        if (std::isnan(value)) return std::nullopt;
    return value;
}

template <class Integer>
Reply<void> read_whole(std::string_view text, Integer& value, std::uint64_t least,
                       std::uint64_t most) {
    const auto read = number<Integer>(text);
    if (!read || *read < least || *read > most)
        return misshapen(
            text, "a whole number from " + std::to_string(least) + " to " + std::to_string(most));
    value = *read;
    return {};
}

/// Parses numbers that float32 can hold, but for their last digits.
std::optional<std::vector<double>> numbers(std::span<const std::string_view> parts) {
    std::vector<double> values;
    for (const std::string_view part : parts) {
        const auto value = number<double>(part);
        if (!value || !(std::abs(*value) <= double{std::numeric_limits<float>::max()}) ||
            (*value != 0 && static_cast<float>(*value) == 0))
            return std::nullopt;
        values.push_back(*value);
    }
    return values;
}

/// Reads `few` or `many` numbers.
Reply<void> read_reals(std::string_view text, Reals& to, const std::string& shape, std::size_t few,
                       std::size_t many, char separator = ',') {
    auto values = numbers(split(text, separator));
    if (!values || (values->size() != few && values->size() != many)) return misshapen(text, shape);
    to.values = std::move(*values);
    return {};
}

/// Reads at most list_items_max items of `each` numbers.
Reply<void> read_list(std::string_view text, Reals& to, const std::string& shape,
                      std::size_t each) {
    auto values = numbers(split(text, ','));
    if (!values || values->size() % each != 0) return misshapen(text, shape);
    if (values->size() / each > limits.list_items_max)
        return refuse(Code::limit_exceeded,
                      "has " + std::to_string(values->size() / each) +
                          " items, over list_items_max = " + std::to_string(limits.list_items_max));
    to.values = std::move(*values);
    return {};
}

/// Reads FIRST:LAST:COUNT.
Reply<void> read_steps(std::string_view text, const std::string& shape, std::uint64_t fewest,
                       std::uint64_t most, Sweep& sweep) {
    const auto parts = split(text, ':');
    const auto ends = parts.size() == 3 ? numbers(std::span(parts).first(2)) : std::nullopt;
    if (!ends) return misshapen(text, shape);
    sweep.start = (*ends)[0];
    sweep.stop = (*ends)[1];
    return read_whole(parts[2], sweep.count, fewest, most);
}

}  // namespace

Reply<void> read(std::string_view text, Name& value) {
    value.value = text;
    return {};
}

Reply<void> read(std::string_view text, Size& value) {
    const auto parts = split(text, 'x');
    if (parts.size() != 2) return misshapen(text, "WIDTHxHEIGHT");
    ImageSize& size = value.value;
    if (auto width = read_whole(parts[0], size.width, 1, limits.picture_side_max); !width)
        return width;
    if (auto height = read_whole(parts[1], size.height, 1, limits.picture_side_max); !height)
        return height;
    if (size.pixels() > limits.picture_pixels_max)
        return refuse(Code::limit_exceeded, "has " + std::to_string(size.pixels()) +
                                                " pixels, over picture_pixels_max = " +
                                                std::to_string(limits.picture_pixels_max));
    return {};
}

Reply<void> read(std::string_view text, Number& value) {
    return read_reals(text, value, "a number", 1, 1);
}

Reply<void> read(std::string_view text, Window& value) {
    return read_reals(text, value, "WIDTHxHEIGHT", 2, 2, 'x');
}

Reply<void> read(std::string_view text, LookAt& value) {
    return read_reals(text, value, "ex,ey,ez,ax,ay,az[,ux,uy,uz]", 6, 9);
}

Reply<void> read(std::string_view text, Matrix& value) {
    return read_reals(text, value, "12 numbers, the rows of a 3x4 matrix", 12, 12);
}

Reply<void> read(std::string_view text, Angle& value) {
    const auto read = number<float>(text);
    if (!read || !(*read >= 0 && *read < 180))
        return misshapen(text, "a number of degrees from 0 to below 180");
    value.value = *read;
    return {};
}

Reply<void> read(std::string_view text, Numbers& value) {
    return read_list(text, value, "numbers separated by commas", 1);
}

Reply<void> read(std::string_view text, Vectors& value) {
    return read_list(text, value, "three numbers for each", 3);
}

Reply<void> read(std::string_view text, Steps& value) {
    if (text.find(':') == std::string_view::npos)
        return read_list(text, value, "numbers separated by commas", 1);
    Sweep sweep;
    if (auto steps = read_steps(text, "LOWEST:HIGHEST:COUNT", 2, limits.list_items_max, sweep);
        !steps)
        return steps;
    const double step = (sweep.stop - sweep.start) / (sweep.count - 1);
    for (std::uint32_t i = 0; i < sweep.count; ++i) value.values.push_back(sweep.start + step * i);
    return {};
}

Reply<void> read(std::string_view text, Sweep& value) {
    return read_steps(text, "START:STOP:COUNT", 1, limits.azimuths_max, value);
}

Reply<void> read(std::string_view text, Range& value) {
    const auto parts = split(text, ':');
    const auto near = number<float>(parts.front());
    const auto far = number<float>(parts.back());
    if (parts.size() != 2 || !near || !far || !std::isfinite(*near))
        return misshapen(text, "NEAR:FAR");
    if (*far == 0)
        return refuse(Code::invalid_field, "a ray cannot end at 0; FAR is more than that, or inf");
    if (*near < 0 || *near > *far) return misshapen(text, "a range with 0 <= tmin <= tmax");
    value = {*near, *far};
    return {};
}

Reply<void> read(std::string_view /*text*/, Sent& /*value*/) {
    return {};
}

Reply<void> read(std::string_view text, Samples& value) {
    return read_whole(text, value.value, 1, limits.samples_max);
}

Reply<void> read(std::string_view text, Whole& value) {
    return read_whole(text, value.value, 0, std::numeric_limits<std::uint64_t>::max());
}

}  // namespace raynest::server::setting
