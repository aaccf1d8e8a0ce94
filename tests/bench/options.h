// The command line of raynest-bench.
#pragma once

#include "engine/bvh/build.h"
#include "engine/packs/abi.h"
#include "engine/result.h"

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace raynest::bench {

struct Options {
    std::string scene = "gen:terrain";
    std::string over;  ///< another form of the same scene: its rows are named own-over
    std::vector<std::string> rays{"primary", "ao", "diffuse", "random"};
    std::string ref;
    std::string kind = "auto";
    std::uint32_t hits_max = 8;
    std::vector<std::string> traversals{"single", "stream", "packet"};
    std::vector<std::string> intersectors{"opaque"};
    std::vector<std::string> counters{"none"};
    std::vector<std::string> targets{"auto"};
    std::vector<unsigned> threads{1};
    std::vector<std::string> peers;
    std::vector<std::filesystem::path> pack_dirs;
    std::uint32_t count = 131072;
    int rounds = 7;
    bool build = false;
    std::vector<BuildQuality> qualities{BuildQuality::fast, BuildQuality::medium,
                                        BuildQuality::high};
    bool json = false;
    std::string command;  ///< as typed, for the row that it makes
};

/// nullopt and the exit code where there is nothing to run: --help, or a usage error.
std::optional<Options> parse_options(int argc, char** argv, int& exit_code);

}  // namespace raynest::bench
