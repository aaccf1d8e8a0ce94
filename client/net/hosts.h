// hosts.toml, in XDG_CONFIG_HOME/raynest or ~/.config/raynest: what `raynest login` keeps of each
// daemon.
//
//   ["tls://gpu.example.org:31062"]
//   token = "rnt_..."
//   ca = "gpu.example.org:31062.ca.pem"      a copy beside hosts.toml, as are cert and key
//
// Each line is TOML by itself. A line that is none is left out and named, and the others count;
// below such a heading all lines are left out, so that no daemon gets another's token. The file and
// the copies have mode 0600. _net/hosts.py of the Python client reads and writes the same.
#pragma once

#include "client/ground/failure.h"

#include <string>
#include <vector>

namespace raynest::client {

/// The kept items of a daemon, files as absolute paths; empty: none.
struct KeptHost {
    std::string token, ca, certificate, key;
    std::vector<std::string> warnings;  ///< lines of the file that were left out, each one sentence
};

/// Returns the path of hosts.toml.
[[nodiscard]] std::string hosts_file();

/// Looks a daemon up; names are compared without case. Fails if other users may read the file.
Result<KeptHost> find_host(const std::string& uri);

/// Keeps a daemon's token, with copies of the files, in the place of what was kept of it.
Result<void> keep_host(const std::string& uri, const KeptHost& host);

/// Removes all that is kept of a daemon. Returns false where nothing was.
Result<bool> forget_host(const std::string& uri);

/// Reads a file of at most `bytes_max` bytes that only this user may read.
Result<std::string> read_secret(const std::string& file, std::size_t bytes_max);

}  // namespace raynest::client
