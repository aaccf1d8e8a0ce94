// --generate KIND key=value...: rays that the daemon makes. What the words mean it checks itself; only
// places, which travel less the scene's origin, and a file of points are read here.
#pragma once

#include "client/failure.h"
#include "client/options.h"
#include "protocol/wire.h"

#include <span>
#include <string>
#include <vector>

namespace raynest::client {

struct Generate {
    wire::GeneratorT message;     ///< without pose and lookat
    std::string points;           ///< file of the points that the rays start from
    std::vector<double> pose;     ///< 12 numbers, or none
    std::vector<double> look_at;  ///< 6 or 9 numbers, or none

    /// The message for a scene with this origin.
    [[nodiscard]] wire::GeneratorT at(const WorldPoint& origin) const;
};

/// Reads the words behind --generate; exit code 2 where one is not key=value.
Result<Generate> parse_generate(std::span<const std::string> words);

/// Every kind with its keys, and every key with its text, for the help.
[[nodiscard]] std::string generate_help();

}  // namespace raynest::client
