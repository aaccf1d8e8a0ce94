// The command lines of this folder's two programs.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace raynest::bench {

/// Options of raynest-bench-cuda.
struct CudaOptions {
    bool timing = false;  ///< true: time; false: check
    std::string pack, cpu_pack, arena, rays;
    std::uint32_t count = 0;  ///< 0: all rays of the file
    std::uint32_t chunk = 1U << 17;
    std::uint32_t rounds = 11;
};

/// Options of raynest-bench-arena.
struct ArenaOptions {
    std::string source, arena;
    std::vector<std::string> rays;  ///< KIND=FILE
    std::uint32_t levels = 0;       ///< levels to keep when merging; 0: as described
    std::uint32_t count = 1U << 16;
};

/// Parses a command line. Returns the options, or the exit code if the line was already answered.
template <class Options>
struct Parsed {
    std::optional<Options> options;
    int exit_code = 0;
};
Parsed<CudaOptions> parse_cuda_options(int argc, const char* const* argv);
Parsed<ArenaOptions> parse_arena_options(int argc, const char* const* argv);

}  // namespace raynest::bench
