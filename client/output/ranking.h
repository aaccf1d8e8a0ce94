// The ranking of a Blame (EXPLAIN.md) as text.
#pragma once

#include "client/ground/json.h"

#include <ostream>
#include <string>

namespace raynest::client {

void print_ranking(const Json& document, std::ostream& to);

/// The number of a row, which equal names do not share: "77" or "77..80", the paths of an instance;
/// the object of a mesh; the index of a material. "" where there is none.
[[nodiscard]] std::string row_number(const Json& row);
/// " (object 3)" or " (material 1)" of a finding.
[[nodiscard]] std::string subject_number(const Json& finding);

}  // namespace raynest::client
