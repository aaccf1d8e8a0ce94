// The limits that follow from other options where the administrator has not set them.
#pragma once

#include "server/options/options.h"

#include <functional>
#include <string>
#include <vector>

namespace raynest::server {

/// Options such as "--principal-scene-bytes-max". In Options::limits, 0 means that it is not given.
[[nodiscard]] const std::vector<std::string>& derived_limits();
/// Changes those that are not given to 0.
void forget_defaults(protocol::Limits& limits,
                     const std::function<bool(const std::string&)>& is_default);

/// Returns the limits of a daemon that runs with these options: those that are not given are parts
/// of --memory and of the disk of --state. After a reload these are the ones of the start, so the
/// file's new ones change nothing before the restart.
[[nodiscard]] protocol::Limits limits_in_force(const Options& options);

}  // namespace raynest::server
