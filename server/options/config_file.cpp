#include "server/options/config_file.h"

#include "server/security/secret_file.h"

#include <algorithm>
#include <array>
#include <filesystem>
#include <string_view>

namespace raynest::server {
namespace {

/// Options whose values are paths; `listen` has one behind unix:.
constexpr std::array<std::string_view, 10> path_options = {
    "tls-cert",   "tls-key", "client-ca", "tokens",     "state",
    "scene-root", "load",    "pack-dir",  "ready-file", "cuda"};

}  // namespace

Result<std::string> read_config_file(const std::string& file) {
    return read_regular_file(file, config_bytes_max, "change the options");
}

std::string resolve_path(const std::string& option, const std::string& value,
                         const std::string& file) {
    constexpr std::string_view unix_scheme = "unix:";
    const bool is_socket = option == "listen" && value.starts_with(unix_scheme);
    const bool is_word =
        (option == "cuda" && (value == "auto" || value == "off")) ||
        (option == "load" && (value.starts_with("builtin:") || value.starts_with("root:")));
    if (!is_socket && (is_word || std::ranges::count(path_options, option) == 0)) return value;
    const std::string path = value.substr(is_socket ? unix_scheme.size() : 0);
    if (path.empty() || path.front() == '/') return value;
    std::error_code error;
    const auto folder = std::filesystem::absolute(file, error).parent_path();
    return (is_socket ? std::string(unix_scheme) : "") +
           (folder / path).lexically_normal().string();
}

}  // namespace raynest::server
