// The command line as a whole: its options as plain structs.
#pragma once

#include "client/commands/command.h"
#include "client/ground/failure.h"
#include "client/net/access.h"

#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace raynest::client {

struct Options {
    std::string server;
    AccessOptions access;
    bool local = false;  ///< a daemon for this command alone
    /// Scheduler of the workers that carry the command out; empty: the daemon does
    std::string dask;
    /// With `dask`: the command and its options, as they were given
    std::vector<std::string> words;
    bool json = false;
    bool quiet = false;
    double reconnect = 10;  ///< seconds to look for a daemon that went away; 0: do not
    std::string word;       ///< that of the command
    bool acts = true;       ///< its request does more when it is sent twice
    std::shared_ptr<Command> command;
};

/// The options, or a text to print instead (help or version). Mistakes give exit code 2.
struct Parsed {
    std::string text;
    std::optional<Options> options;
};
Result<Parsed> parse_options(int argc, const char* const* argv);

}  // namespace raynest::client
