// The subcommands of raynestd that start no daemon: `tls` makes certificates, `token` edits the
// token file, `check`, `backup`, `restore` and `gc` look after a state folder.
#pragma once

#include <optional>

namespace raynest::server {

/// Runs `raynestd tls ...`, `raynestd token ...` or a command of a state folder (check_command.h)
/// and returns its exit code: 0, 1 after a failure, 2 after a usage error or 5 for a token that is not there, with one
/// line on stderr. Returns nothing for another command line.
[[nodiscard]] std::optional<int> run_command(int argc, const char* const* argv);

}  // namespace raynest::server
