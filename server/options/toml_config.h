// Reads and writes configurations in TOML. Only toml_config.cpp includes toml++.
#pragma once

#include "server/options/config_file.h"

namespace raynest::server {

/// Parses the content of a file: KEY = VALUE, or KEY = [VALUE, ...], where a value is a string, a
/// number or true. Returns the keys in the order of their lines.
[[nodiscard]] tl::expected<std::vector<ConfigKey>, ConfigFault> read_toml(
    const std::string& content);

/// Returns a text as TOML spells it: in quotes.
[[nodiscard]] std::string toml_text(const std::string& text);

}  // namespace raynest::server
