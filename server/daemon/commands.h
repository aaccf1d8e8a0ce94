// The subcommands of raynestd that start no daemon: `tls` makes certificates, `token` edits the
// token file, `check`, `backup`, `restore` and `gc` care for a state folder, `draw` draws a heat map.
#pragma once

#include <optional>

namespace raynest::server {

/// Runs one of them and returns its exit code: 0, 1 after a failure, 2 after a usage error or 5 for a token that is not there, with one
/// line on stderr. Returns nothing for another command line.
[[nodiscard]] std::optional<int> run_command(int argc, const char* const* argv);

}  // namespace raynest::server
