// What the daemon checks before it starts.
#pragma once

#include "engine/result.h"
#include "server/options.h"

namespace raynest::server {

/// Raises the limit of file descriptors to the maximum that the system grants. Fails if that is too
/// little for the daemon and a few clients.
[[nodiscard]] Result<void> raise_descriptor_limit();

/// Warns of options without an effect: access to Unix sockets that are not there, folders without
/// kernel packs.
void warn_of_useless(const Options& options);

}  // namespace raynest::server
