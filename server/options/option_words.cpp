#include "server/options/option_words.h"

#include "engine/packs/registry.h"
#include "server/ground/address.h"
#include "server/ground/size.h"
#include "server/net/address_set.h"

#include <algorithm>
#include <cctype>
#include <cstdint>
#include <cstdlib>

namespace raynest::server {
namespace {

constexpr std::uint64_t memory_min = 1ULL << 20;
constexpr std::uint64_t memory_max = 1ULL << 50;

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

std::string proxy_fault(const std::string& text) {
    return AddressSet().add(text);
}

std::string memory_fault(std::string& text) {
    const auto bytes = parse_size(text);
    if (!bytes || *bytes < memory_min || *bytes > memory_max)
        return "'" + text + "' is not a size from 1M to 1P, such as 8G or 1.5G";
    text = std::to_string(*bytes);
    return "";
}

std::string bytes_fault(std::string& text) {
    const auto bytes = parse_size(text);
    if (!bytes) return "'" + text + "' is not a number of bytes, such as 65536, 500M or 20G";
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
