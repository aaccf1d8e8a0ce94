// What the daemon checks before it starts.
#pragma once

#include "engine/result.h"
#include "server/options.h"

#include <optional>
#include <string>

namespace raynest::server {

/// Raises the limit of file descriptors to the maximum that the system grants. Fails if that is too
/// little for the daemon and a few clients.
[[nodiscard]] Result<void> raise_descriptor_limit();

/// Returns the first option for which the daemon could not start: files of TLS, tokens, packs, the state
/// folder, folders of sockets. Binds no address and takes no lock, so a daemon may run meanwhile.
[[nodiscard]] std::optional<OptionFault> start_fault(const Options& options);

/// Warns of options without an effect: access to Unix sockets that are not there, folders without
/// kernel packs.
void warn_of_useless(const Options& options);

}  // namespace raynest::server
