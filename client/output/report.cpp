#include "client/output/report.h"

#include "client/files/files.h"
#include "client/output/template.h"
#include "protocol/base64.h"

namespace raynest::client {
namespace {

/// protocol/report.html, written into this file's folder by CMake.
constexpr std::string_view report_text =
#include "client/output/report_text.inc"
    ;

}  // namespace

bool is_report(const std::string& path) {
    return extension_of(path) == ".html";
}

std::string report_html(const Report& report) {
    Json checks = Json::array();
    for (const Verdict& verdict : report.checks)
        checks.push_back(
            {{"verdict", verdict.exceeded ? "bad" : "good"}, {"text", verdict_text(verdict)}});
    return fill_template(report_text, {{"heat", report.heat},
                                       {"ranking", report.ranking},
                                       {"picture", protocol::to_base64(report.picture)},
                                       {"limits", !checks.empty()},
                                       {"checks", std::move(checks)},
                                       {"commands", {report.command_line}},
                                       {"camera", report.camera.empty() ? report.heat.at("camera")
                                                                        : Json(report.camera)},
                                       {"version", RAYNEST_VERSION}});
}

}  // namespace raynest::client
