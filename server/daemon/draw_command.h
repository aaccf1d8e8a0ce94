// raynestd draw: the PNG of a heat map, of counts that raynest merge has joined.
#pragma once

#include <iosfwd>

namespace raynest::server {

/// Reads a line of JSON, which says what the counts are and how they are shown, and behind it 32
/// bits for each pixel, of a difference with a sign. Writes the file that a heat map of these counts
/// is. Returns the exit code: 0, or 1 after a failure, with one line in `said`.
[[nodiscard]] int draw_heat_map(std::istream& in, std::ostream& out, std::ostream& said);

}  // namespace raynest::server
