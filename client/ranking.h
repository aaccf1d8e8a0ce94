// The ranking of a Blame (EXPLAIN.md) as text.
#pragma once

#include "client/explanation.h"

#include <ostream>

namespace raynest::client {

void print_ranking(const Json& document, std::ostream& to);

}  // namespace raynest::client
