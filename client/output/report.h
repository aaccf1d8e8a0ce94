// heatmap -o report.html: one file that shows what a scene's rays cost, for a ticket. Its text is
// protocol/report.html, which the page fills, too.
#pragma once

#include "client/ground/json.h"
#include "client/output/fail_if.h"

#include <cstddef>
#include <string>
#include <vector>

namespace raynest::client {

/// True if a file of this name is a report.
[[nodiscard]] bool is_report(const std::string& path);

struct Report {
    Json heat;                       ///< the document of the heat map, with its PNG
    Json ranking;                    ///< the document of the ranking
    std::vector<std::byte> picture;  ///< a PNG of the same view
    std::vector<Verdict> checks;
    std::string command_line;
    std::string camera;  ///< in words; empty: as the daemon names it
};

/// Returns a page that needs no other file, no network and no script. Names out of the scene are
/// text in it, whatever they contain.
[[nodiscard]] std::string report_html(const Report& report);

}  // namespace raynest::client
