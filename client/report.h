// heatmap -o report.html: one file that shows what a scene's rays cost, for a ticket.
#pragma once

#include "client/fail_if.h"
#include "client/output.h"

#include <cstddef>
#include <string>
#include <vector>

namespace raynest::client {

struct Report {
    Json heat;                       ///< the document of the heat map, with its PNG
    Json ranking;                    ///< the document of the ranking
    std::vector<std::byte> picture;  ///< a PNG of the same view
    std::vector<Verdict> checks;
    std::string command_line;
};

/// Returns a page that needs no other file, no network and no script. Names out of the scene are
/// text in it, whatever they contain.
[[nodiscard]] std::string report_html(const Report& report);

/// Returns text with the letters replaced that HTML gives a meaning.
[[nodiscard]] std::string escape_html(std::string_view text);

}  // namespace raynest::client
