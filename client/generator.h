// --generate KIND key=value...: rays that the daemon makes.
#pragma once

#include "client/failure.h"
#include "client/options.h"
#include "protocol/wire.h"

#include <span>
#include <string>
#include <vector>

namespace raynest::client {

struct Generate {
    wire::GeneratorT message;
    std::string points;           ///< file of the points of a hemisphere
    std::vector<double> pose;     ///< 12 numbers, or none
    std::vector<double> look_at;  ///< 6 or 9 numbers, or none

    /// The message for a scene with this origin.
    [[nodiscard]] wire::GeneratorT at(const WorldPoint& origin) const;
};

/// Reads the words behind --generate; exit code 2 names a key that is wrong, or not one of its
/// kind, and those there are.
Result<Generate> parse_generate(std::span<const std::string> words);

/// Every key with its text, for the help.
[[nodiscard]] std::string generate_help();

}  // namespace raynest::client
