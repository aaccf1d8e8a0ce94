#include "server/options/config_file.h"

#include "server/options/toml_config.h"
#include "server/security/file_place.h"

#include <sys/stat.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <istream>
#include <string_view>

namespace raynest::server {
namespace {

/// Options whose values are paths; `listen` has one behind unix:.
constexpr std::array<std::string_view, 10> path_options = {
    "tls-cert",   "tls-key", "client-ca", "tokens",     "state",
    "scene-root", "load",    "pack-dir",  "ready-file", "cuda"};

}  // namespace

std::string config_file_fault(const std::string& file) {
    struct stat status {};
    if (stat(file.c_str(), &status) != 0) return std::strerror(errno);
    if (S_ISDIR(status.st_mode)) return "it is a folder";
    if (!S_ISREG(status.st_mode)) return "it is not a regular file";
    if (static_cast<std::size_t>(status.st_size) > config_bytes_max)
        return "it is over " + std::to_string(config_bytes_max) + " bytes";
    return place_fault(file, "change the options");
}

tl::expected<std::vector<ConfigKey>, ConfigFault> read_config(std::istream& content) {
    std::string text(config_bytes_max + 1, '\0');
    content.read(text.data(), static_cast<std::streamsize>(text.size()));
    text.resize(static_cast<std::size_t>(content.gcount()));
    if (text.size() > config_bytes_max)
        return tl::unexpected(
            ConfigFault{1, "the file is over " + std::to_string(config_bytes_max) + " bytes"});
    return read_toml(text);
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
