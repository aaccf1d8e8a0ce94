#include "server/ground/size.h"

#include <algorithm>
#include <cctype>
#include <charconv>
#include <cmath>
#include <string>

namespace raynest::server {
namespace {

constexpr std::uint64_t bytes_end = 1ULL << 63;

char to_lower(char c) {
    return static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
}

}  // namespace

std::optional<std::uint64_t> parse_size(std::string_view text) {
    const char* const last = text.data() + text.size();
    // Whole numbers stay exact beyond 2^53.
    std::uint64_t whole = 0;
    if (const auto [end, error] = std::from_chars(text.data(), last, whole);
        error == std::errc{} && end == last)
        return whole < bytes_end ? std::optional(whole) : std::nullopt;
    double number = 0;
    const auto [end, error] = std::from_chars(text.data(), last, number);
    std::string unit(end, last);
    std::erase(unit, ' ');
    std::ranges::transform(unit, unit.begin(), to_lower);
    for (const char* end_of_unit : {"b", "i"})
        if (unit.ends_with(end_of_unit)) unit.pop_back();
    const std::size_t power = unit.size() == 1 ? std::string_view(" kmgtp").find(unit) : 0;
    if (error != std::errc{} || unit.size() > 1 || power == std::string_view::npos)
        return std::nullopt;
    number = std::ldexp(number, static_cast<int>(10 * power));
    if (!(number >= 0 && number < static_cast<double>(bytes_end))) return std::nullopt;
    return static_cast<std::uint64_t>(number);
}

}  // namespace raynest::server
