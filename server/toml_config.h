// Reads a configuration file in TOML. Only toml_config.cpp includes toml++.
#pragma once

#include "server/config_file.h"

namespace raynest::server {

/// Parses the content of a file: KEY = VALUE, or KEY = [VALUE, ...], where a value is a string, a
/// number or true. Returns the keys in the order of their lines.
[[nodiscard]] tl::expected<std::vector<ConfigKey>, ConfigFault> read_toml(const std::string& content);

}  // namespace raynest::server
