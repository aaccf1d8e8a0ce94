// The options of the daemon, from its command line and configuration file.
//
// Precedence: flag, then environment (--log-level is RAYNEST_LOG_LEVEL), then --config FILE, then
// the defaults below. Only parse_options.cpp and daemon/commands.cpp include CLI11.
#pragma once

#include "protocol/limits.h"
#include "server/ground/address.h"
#include "server/ground/log.h"
#include "server/security/credentials.h"

#include <cstdint>
#include <filesystem>
#include <iosfwd>
#include <optional>
#include <string>
#include <vector>

namespace raynest::server {

/// The HTTP port.
struct HttpOptions {
    std::string address = "127.0.0.1:31061";  ///< HOST:PORT, https://HOST:PORT or "off"
    bool given = false;                ///< false: the daemon starts without it if the port is taken
    std::vector<std::string> hosts;    ///< allowed Host headers besides loopback
    std::vector<std::string> proxies;  ///< addresses and networks whose X-Forwarded-* headers count
};

struct Options {
    std::vector<std::string> listen{"tcp://127.0.0.1:31060"};
    HttpOptions http;
    std::filesystem::path state;  ///< locked while the daemon runs; empty: none
    bool takeover = false;        ///< take the place of the daemon that uses `state`, if one does
    std::filesystem::path scene_root;  ///< folder of root:PATH; empty: root:PATH is refused
    std::vector<std::string> load;     ///< sources of start_loads.h
    std::vector<std::filesystem::path> pack_dirs;
    unsigned threads = 0;      ///< compute threads, >= 1 once parsed
    std::uint64_t memory = 0;  ///< bytes for scenes, uploads and jobs, > 0 once parsed
    std::string target = "auto";
    std::filesystem::path cuda_pack;  ///< kernel pack of the CUDA worker; empty: no worker
    std::filesystem::path ready_file;
    SocketAccess socket;  ///< access to every unix:PATH
    SecurityOptions security;
    LogLevel log_level = LogLevel::info;
    LogFormat log_format = LogFormat::text;
    protocol::Limits limits;  ///< as given; the daemon runs with limits_in_force()
};

/// The options to run with, or else the exit code of a command line that is already answered: 0
/// after --help, --version or --print-config; 1 if stdout could not be written; 2 after a usage
/// error, with one line of `errors`.
struct ParsedOptions {
    std::optional<Options> options;
    int exit_code = 0;
    std::string fault = {};  ///< the error, without the words around it
};

/// Says why an option is wrong whose value alone is good.
struct OptionFault {
    std::string option;  ///< without dashes
    std::string value;   ///< as it was given, to find its line in a file; empty: any
    std::string why;     ///< begins with a verb, or with the value; spells options with dashes
};

/// Returns what is wrong with the addresses: one is given twice, or lacks security
/// (listen_policy.h).
[[nodiscard]] std::optional<OptionFault> listen_fault(const Options& options);

/// Parses the command line; --check-config looks at all files, too, as far as a start would. May
/// print to stdout and to `errors`; does not throw or exit.
[[nodiscard]] ParsedOptions parse_options(int argc, const char* const* argv, std::ostream& errors);

}  // namespace raynest::server
