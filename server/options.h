// The daemon's command line and configuration file, as one plain struct.
//
// Order of precedence: flag, then RAYNEST_* environment (target only), then --config FILE, then the
// defaults here. CLI11 stays in options.cpp.
#pragma once

#include "protocol/limits.h"
#include "server/address.h"
#include "server/log.h"

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace raynest::server {

struct Options {
    std::vector<std::string> listen{"tcp://127.0.0.1:31060"};
    std::filesystem::path state;       ///< locked while the daemon runs; empty: none
    std::filesystem::path scene_root;  ///< where root:PATH is looked up; empty: refused
    std::vector<std::filesystem::path> pack_dirs;
    unsigned threads = 0;      ///< compute threads, >= 1 once parsed
    std::uint64_t memory = 0;  ///< bytes for scenes, uploads and jobs, > 0 once parsed
    std::string target = "auto";
    std::filesystem::path cuda_pack;  ///< for the CUDA worker; empty: none
    std::filesystem::path ready_file;
    SocketAccess socket;  ///< of every unix:PATH
    LogLevel log_level = LogLevel::info;
    protocol::Limits limits;
};

/// Either options to run with, or the exit code of a command line that is already answered:
/// --help, --version and --print-config (0), a usage error (2, one line on stderr).
struct ParsedOptions {
    std::optional<Options> options;
    int exit_code = 0;
};

/// Prints to stdout and stderr; never throws, never exits.
[[nodiscard]] ParsedOptions parse_options(int argc, const char* const* argv);

}  // namespace raynest::server
