#include "client/ground/text.h"

#include <array>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <utility>

namespace raynest::client {

std::string shown_text(std::string_view text) {
    return protocol::clean_text(text, text.size());
}

std::string grouped(std::uint64_t number) {
    std::string text = std::to_string(number);
    for (std::size_t at = text.size(); at > 3;) {
        at -= 3;
        text.insert(at, ",");
    }
    return text;
}

std::string seconds_text(double seconds) {
    std::array<char, 32> text;
    std::snprintf(text.data(), text.size(), "%.3f s", seconds);
    return text.data();
}

std::string age_text(double seconds) {
    static constexpr std::array<std::pair<double, char>, 3> units = {
        {{86400, 'd'}, {3600, 'h'}, {60, 'm'}}};
    for (const auto& [unit, letter] : units)
        if (seconds >= unit) return std::to_string(static_cast<long>(seconds / unit)) + letter;
    return std::to_string(static_cast<long>(seconds)) + 's';
}

namespace {

template <class Number>
std::string shortest_text(Number value) {
    if (!std::isfinite(value)) return "null";
    std::array<char, 32> text;
    const Number shown = value + Number{0};  // without -0
    const auto [end, error] = std::to_chars(text.data(), text.data() + text.size(), shown);
    return std::string(text.data(), end);
}

}  // namespace

std::string float_text(float value) {
    return shortest_text(value);
}

std::string double_text(double value) {
    return shortest_text(value);
}

std::string world_text(float relative, double origin) {
    return origin == 0 ? float_text(relative) : shortest_text(double{relative} + origin);
}

std::string environment_variable(const char* name) {
    const char* value = std::getenv(name);
    return value == nullptr ? "" : value;
}

}  // namespace raynest::client
