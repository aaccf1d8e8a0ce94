#include "server/config_file.h"

#include "server/toml_config.h"

#include <sys/stat.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <iomanip>
#include <istream>
#include <optional>
#include <sstream>
#include <string_view>

namespace raynest::server {
namespace {

/// Options whose values are paths; `listen` has one behind unix:.
constexpr std::array<std::string_view, 9> path_options = {
    "tls-cert", "tls-key", "client-ca", "tokens", "state",
    "scene-root", "pack-dir", "ready-file", "cuda"};

std::string trimmed(std::string_view text) {
    constexpr std::string_view blanks = " \t\r\n\f\v";
    const std::size_t first = text.find_first_not_of(blanks);
    if (first == std::string_view::npos) return "";
    return std::string(text.substr(first, text.find_last_not_of(blanks) - first + 1));
}

/// Splits the part of a line after KEY= into values: words or quoted texts. '#' before a value
/// begins a comment. Returns nothing if a quote is not closed.
std::optional<std::vector<std::string>> to_values(const std::string& text) {
    std::vector<std::string> values;
    std::istringstream left(text);
    while (!(left >> std::ws).eof() && left.peek() != '#') {
        const auto first = static_cast<char>(left.peek());
        std::string& value = values.emplace_back();
        if (first == '"' || first == '\'')
            left >> std::quoted(value, first);
        else
            left >> value;
        if (!left) return std::nullopt;
    }
    return values;
}

/// Parses a line without its newline. Returns nothing for an empty line or a comment, and the error
/// text for an invalid line.
tl::expected<std::optional<ConfigKey>, std::string> to_key(const std::string& line,
                                                           std::size_t number) {
    const auto is_control = [](char c) { return c != '\t' && (c == 0x7F || (c >= 0 && c < ' ')); };
    const std::string text = trimmed(line);
    if (text.empty() || text.front() == '#') return std::nullopt;
    if (std::ranges::any_of(text, is_control))
        return tl::unexpected<std::string>("it holds a control character; write plain text");
    if (text.front() == '[')
        return tl::unexpected<std::string>(
            "sections are not known here; write KEY=VALUE, as raynestd --print-config does");
    const std::size_t equals = text.find('=');
    const std::string name = trimmed(text.substr(0, equals));
    auto values = to_values(equals == std::string::npos ? "" : text.substr(equals + 1));
    if (!values) return tl::unexpected("'" + name + "' has a quote that is not closed");
    if (values->empty() || std::ranges::count(*values, "") != 0)
        return tl::unexpected("'" + name + "' has no value; write " + name +
                              "=VALUE, or leave the line out");
    const std::vector<std::size_t> lines(values->size(), number);
    return ConfigKey{number, name, std::move(*values), lines};
}

tl::expected<std::vector<ConfigKey>, ConfigFault> read_lines(const std::string& content) {
    constexpr std::string_view byte_order_mark = "\xEF\xBB\xBF";
    std::istringstream left(content);
    std::vector<ConfigKey> keys;
    std::string line;
    for (std::size_t number = 1; std::getline(left, line); ++number) {
        if (number == 1 && line.starts_with(byte_order_mark)) line.erase(0, byte_order_mark.size());
        auto key = to_key(line, number);
        if (!key) return tl::unexpected(ConfigFault{number, key.error()});
        if (*key) keys.push_back(std::move(**key));
    }
    return keys;
}

}  // namespace

std::string config_file_fault(const std::string& file) {
    struct stat status {};
    if (stat(file.c_str(), &status) != 0) return std::strerror(errno);
    if (S_ISDIR(status.st_mode)) return "it is a folder";
    if (!S_ISREG(status.st_mode)) return "it is not a regular file";
    if (static_cast<std::size_t>(status.st_size) > config_bytes_max)
        return "it is over " + std::to_string(config_bytes_max) + " bytes";
    return "";
}

tl::expected<std::vector<ConfigKey>, ConfigFault> read_config(const std::string& file,
                                                              std::istream& content) {
    std::string text(config_bytes_max + 1, '\0');
    content.read(text.data(), static_cast<std::streamsize>(text.size()));
    text.resize(static_cast<std::size_t>(content.gcount()));
    if (text.size() > config_bytes_max)
        return tl::unexpected(ConfigFault{
            1, "the file is over " + std::to_string(config_bytes_max) + " bytes"});
    return file.ends_with(".toml") ? read_toml(text) : read_lines(text);
}

std::string resolve_path(const std::string& option, const std::string& value,
                         const std::string& file) {
    constexpr std::string_view unix_scheme = "unix:";
    const bool is_socket = option == "listen" && value.starts_with(unix_scheme);
    const bool is_word = option == "cuda" && (value == "auto" || value == "off");
    if (!is_socket && (is_word || std::ranges::count(path_options, option) == 0)) return value;
    const std::string path = value.substr(is_socket ? unix_scheme.size() : 0);
    if (path.empty() || path.front() == '/') return value;
    std::error_code error;
    const auto folder = std::filesystem::absolute(file, error).parent_path();
    return (is_socket ? std::string(unix_scheme) : "") + (folder / path).lexically_normal().string();
}

}  // namespace raynest::server
