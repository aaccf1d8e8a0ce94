#include "client/ground/numbers.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <limits>
#include <utility>

namespace raynest::client {
namespace {

tl::unexpected<Failure> misshapen(const std::string& text, const std::string& shape) {
    return fail(Exit::usage, "'" + text + "' is not " + shape);
}

constexpr float float_max = std::numeric_limits<float>::max();

}  // namespace

std::vector<std::string> split(std::string_view text, char separator) {
    std::vector<std::string> parts;
    while (true) {
        const std::size_t end = std::min(text.find(separator), text.size());
        const std::string_view part = text.substr(0, end);
        const std::size_t first = std::min(part.find_first_not_of(' '), end);
        parts.emplace_back(part.substr(first, part.find_last_not_of(' ') + 1 - first));
        if (end == text.size()) return parts;
        text.remove_prefix(end + 1);
    }
}

Result<std::array<std::uint32_t, 2>> parse_pixel(const std::string& text) {
    std::array<std::uint32_t, 2> pixel{};
    const char* const end = text.data() + text.size();
    const auto column = std::from_chars(text.data(), end, pixel[0]);
    if (column.ec == std::errc{} && column.ptr != end && *column.ptr == ',') {
        const auto row = std::from_chars(column.ptr + 1, end, pixel[1]);
        if (row.ec == std::errc{} && row.ptr == end) return pixel;
    }
    return misshapen(text, "a pixel X,Y, two whole numbers from 0");
}

Result<std::uint64_t> parse_duration(const std::string& text) {
    static constexpr std::array<std::pair<char, double>, 4> units = {
        {{'s', 1e3}, {'m', 60e3}, {'h', 3600e3}, {'d', 86400e3}}};
    constexpr double days_max = 36500;
    double number = 0;
    const char* last = text.data() + text.size();
    const auto [end, error] = std::from_chars(text.data(), last, number);
    for (const auto& [letter, milliseconds] : units) {
        if (error != std::errc{} || end + 1 != last || *end != letter) continue;
        const double product = number * milliseconds;
        if (product >= 1 && product <= days_max * units.back().second)
            return static_cast<std::uint64_t>(product);
    }
    return misshapen(text, "a time such as 90s, 30m, 1h or 2d");
}

Result<std::vector<double>> parse_world(const std::string& text, std::size_t few, std::size_t many,
                                        const std::string& shape) {
    std::vector<double> numbers;
    for (const std::string& part : split(text)) {
        const char* begin = part.c_str() + (part.starts_with('+') ? 1 : 0);
        double value = 0;
        const auto [end, error] = std::from_chars(begin, part.c_str() + part.size(), value);
        // Numbers are sent as float32, positions relative to the scene's origin.
        const bool fits = !std::isfinite(value) || std::abs(value) <= double{float_max};
        if (error == std::errc::result_out_of_range || (error == std::errc{} && !fits))
            return fail(Exit::usage, "'" + part + "' does not fit a 32-bit float");
        if (error != std::errc{} || end != part.c_str() + part.size())
            return misshapen(text, shape);
        numbers.push_back(value);
    }
    if (numbers.size() != few && numbers.size() != many) return misshapen(text, shape);
    return numbers;
}

Result<std::uint32_t> parse_mask(std::string_view text) {
    std::string_view digits = text;
    if (digits.starts_with("0x") || digits.starts_with("0X")) digits.remove_prefix(2);
    std::uint32_t mask = 0;
    const char* const end = digits.data() + digits.size();
    const auto [stop, error] = std::from_chars(digits.data(), end, mask, 16);
    if (error == std::errc{} && stop == end && digits.size() <= 8) return mask;
    return misshapen(std::string(text), "a mask of 1 to 8 hexadecimal digits");
}

Result<void> check_mask_rule(std::string_view rule) {
    const std::size_t equals = rule.rfind('=');
    if (equals == 0 || equals == std::string_view::npos)
        return misshapen(std::string(rule), "GLOB=HEX, as 'stand-*/birch-*=F0'");
    if (const auto mask = parse_mask(rule.substr(equals + 1)); !mask)
        return tl::unexpected<Failure>(mask.error());
    return {};
}

}  // namespace raynest::client
