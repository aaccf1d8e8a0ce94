#include "server/option_words.h"

#include "engine/packs/registry.h"
#include "server/address.h"
#include "server/net/http_site.h"

#include <algorithm>
#include <cctype>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <optional>

namespace raynest::server {
namespace {

char to_lower(char c) {
    return static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
}

/// Parses a size; nothing if it is invalid or not from 1M to 1P.
std::optional<std::uint64_t> to_size(const std::string& text) {
    double number = 0;
    const char* last = text.data() + text.size();
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
    const bool fits = number >= std::ldexp(1, 20) && number <= std::ldexp(1, 50);
    return fits ? std::optional(static_cast<std::uint64_t>(number)) : std::nullopt;
}

}  // namespace

std::string address_fault(const std::string& uri) {
    const auto address = parse_address(uri);
    return address ? std::string() : address.error().message;
}

std::string http_fault(const std::string& text) {
    if (text == "off") return {};
    const auto address = parse_http_address(text);
    return address ? std::string() : address.error().message;
}

std::string http_host_fault(const std::string& text) {
    return is_http_host(text) ? "" : "'" + text + "' is not a host; write NAME or NAME:PORT";
}

std::string size_fault(std::string& text) {
    const auto bytes = to_size(text);
    if (!bytes) return "'" + text + "' is not a size from 1M to 1P, such as 8G or 1.5G";
    text = std::to_string(*bytes);
    return "";
}

LogLevel to_log_level(const std::string& word) {
    if (word == "error") return LogLevel::error;
    if (word == "warn") return LogLevel::warn;
    return word == "debug" ? LogLevel::debug : LogLevel::info;
}

std::filesystem::path to_cuda_pack(const std::string& word) {
    if (word == "off") return {};
    if (word != "auto") return std::filesystem::absolute(word);
    std::error_code error;
    const auto pack =
        builtin_pack_directory().parent_path() / "raynest-cuda" / "raynest-pack-cuda.so";
    return std::filesystem::exists(pack, error) ? pack : std::filesystem::path();
}

std::string hyphened(std::string_view name) {
    std::string text(name);
    std::replace(text.begin(), text.end(), '_', '-');
    return text;
}

std::string variable_of(const std::string& option) {
    std::string name = "RAYNEST_";
    for (const char c : option) name += c == '-' ? '_' : static_cast<char>(std::toupper(c));
    return name;
}

bool is_in_environment(const std::string& option) {
    // getenv() is safe here: nobody sets variables.
    const char* value = std::getenv(variable_of(option).c_str());  // NOLINT(concurrency-mt-unsafe)
    return value != nullptr && value[0] != '\0';
}

}  // namespace raynest::server
