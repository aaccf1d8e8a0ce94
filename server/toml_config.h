// Reads a configuration file in TOML. Only toml_config.cpp includes toml++.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include <tl/expected.hpp>

namespace raynest::server {

/// A key of the file with its values as texts.
struct ConfigKey {
    std::size_t line = 0;
    std::string name;
    std::vector<std::string> values;  ///< several for an array
};

/// Why a file is no configuration.
struct ConfigFault {
    std::size_t line = 0;
    std::string why;
};

/// Parses the content of a file: KEY = VALUE, or KEY = [VALUE, ...], where a value is a string, a
/// number or true. Returns the keys in the order of their lines.
[[nodiscard]] tl::expected<std::vector<ConfigKey>, ConfigFault> read_toml(const std::string& content);

}  // namespace raynest::server
