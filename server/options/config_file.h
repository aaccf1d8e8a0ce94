// Reads a configuration file in TOML, as --print-config writes it. what the keys mean,
// parse_options.cpp knows.
#pragma once

#include <tl/expected.hpp>

#include <cstddef>
#include <iosfwd>
#include <string>
#include <vector>

namespace raynest::server {

/// Maximum size of a configuration file.
inline constexpr std::size_t config_bytes_max = 1 << 20;

/// A key of the file with its values as texts.
struct ConfigKey {
    std::size_t line = 0;
    std::string name;
    std::vector<std::string> values;  ///< several for a list
    std::vector<std::size_t> lines;   ///< each value's
};

/// Why a file is no configuration.
struct ConfigFault {
    std::size_t line = 0;
    std::string why;
};

/// Returns why this path is not read: it is no regular file, or too large. Empty if it may be read.
[[nodiscard]] std::string config_file_fault(const std::string& file);

/// Parses the content of a file. Returns the keys in the order of their lines.
[[nodiscard]] tl::expected<std::vector<ConfigKey>, ConfigFault> read_config(std::istream& content);

/// Returns a value whose relative path is made absolute, from the folder of the file on. Values of
/// options without paths stay.
[[nodiscard]] std::string resolve_path(const std::string& option, const std::string& value,
                                       const std::string& file);

}  // namespace raynest::server
