// The command lines of this folder's two programs.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace raynest::bench {

/// Of raynest-bench-cuda.
struct CudaOptions {
    bool timing = false;  ///< time, else check
    std::string pack, cpu_pack, arena, rays;
    std::uint32_t count = 0;  ///< 0: as many as the file has
    std::uint32_t chunk = 1U << 17;
    std::uint32_t rounds = 11;
};

/// Of raynest-bench-bake.
struct BakeOptions {
    std::string source, arena;
    std::vector<std::string> rays;  ///< KIND=FILE
    std::uint32_t levels = 0;       ///< merged until there are so many; 0: as described
    std::uint32_t count = 1U << 16;
};

/// Either options to run with, or the exit code of a command line that is already answered.
template <class Options>
struct Parsed {
    std::optional<Options> options;
    int exit_code = 0;
};
Parsed<CudaOptions> parse_cuda_options(int argc, const char* const* argv);
Parsed<BakeOptions> parse_bake_options(int argc, const char* const* argv);

}  // namespace raynest::bench
