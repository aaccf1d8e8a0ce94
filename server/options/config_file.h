// Reads a configuration file in TOML, as --print-config writes it. parse_options.cpp knows what the
// keys mean.
#pragma once

#include "engine/result.h"

#include <tl/expected.hpp>

#include <cstddef>
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

/// Reads a file whole. Fails if it is no regular file, too large, or if others could change it.
[[nodiscard]] Result<std::string> read_config_file(const std::string& file);

/// Returns a value whose relative path is made absolute, from the folder of the file on. Values of
/// options without paths stay.
[[nodiscard]] std::string resolve_path(const std::string& option, const std::string& value,
                                       const std::string& file);

}  // namespace raynest::server
