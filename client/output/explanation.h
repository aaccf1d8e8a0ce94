// The JSON documents about rays that the daemon sends (EXPLAIN.md), and how they read as text.
#pragma once

#include "client/ground/json.h"

#include <ostream>

namespace raynest::client {

/// The tree of an Explain, a step per line.
void print_explanation(const Json& document, std::ostream& to);
/// The rays of a path, a ray per line.
void print_path(const Json& document, std::ostream& to);

}  // namespace raynest::client
