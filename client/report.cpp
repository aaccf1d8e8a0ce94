#include "client/report.h"

#include "client/ranking.h"
#include "protocol/base64.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <string_view>

namespace raynest::client {
namespace {

/// The policy refuses scripts and everything from elsewhere, in case a name were not escaped.
constexpr std::string_view head = R"(<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>
:root { color-scheme: light dark; --ink: #1b1d22; --paper: #fff; --line: #d5d8de; --faint: #5b616e; --bar: #2f6fdb; --bad: #b3261e; --good: #1b6e3c; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e8ec; --paper: #16181d; --line: #363b45; --faint: #a2a9b8; --bar: #6ea0f5; --bad: #ff8a80; --good: #7bd49b; } }
body { margin: 0 auto; padding: 1.5rem; max-width: 82rem; color: var(--ink); background: var(--paper); font: 15px/1.5 system-ui, sans-serif; }
h1 { font-size: 1.5rem; margin: 0 0 .5rem; } h2 { font-size: 1.1rem; margin: 2rem 0 .5rem; }
code { font: 13px/1.5 ui-monospace, monospace; overflow-wrap: anywhere; }
.command { border: 1px solid var(--line); border-radius: 6px; padding: .5rem .75rem; }
.pair { display: grid; grid-template-columns: repeat(auto-fit, minmax(28rem, 1fr)); gap: 1rem; }
figure { margin: 0; } .pair figure:first-child img { background: #767676; } img { max-width: 100%; height: auto; display: block; border-radius: 4px; }
figcaption, .faint { color: var(--faint); font-size: .9rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; width: 100%; }
th, td { text-align: right; padding: .2rem .6rem; border-bottom: 1px solid var(--line); }
th:first-child, td:first-child { text-align: left; overflow-wrap: anywhere; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .1rem 1rem; margin: .75rem 0; } dt { color: var(--faint); } dd { margin: 0; overflow-wrap: anywhere; }
.bad { color: var(--bad); font-weight: 600; } .good { color: var(--good); }
svg { width: 100%; height: auto; } svg rect { fill: var(--bar); } svg text { fill: var(--faint); font: 12px system-ui, sans-serif; } svg line { stroke: var(--line); }
</style>
)";

std::string text(const Json& value) {
    return escape_html(value.is_string() ? value.get<std::string>() : value.dump());
}

template <class... Numbers>
std::string formatted(const char* format, Numbers... numbers) {
    std::array<char, 64> line{};
    std::snprintf(line.data(), line.size(), format, numbers...);
    return line.data();
}

/// A count with its thousands apart; a difference with its sign.
std::string whole(const Json& value, bool differs) {
    const auto number = value.get<std::int64_t>();
    const std::string digits = grouped(static_cast<std::uint64_t>(std::abs(number)));
    return (number < 0 ? "-" : differs && number > 0 ? "+" : "") + digits;
}

std::string percent(const Json& share) {
    return formatted("%.1f %%", 100 * share.get<double>());
}

std::string image(const std::string& base64, const std::string& words) {
    return "<figure><img src=\"data:image/png;base64," + base64 + "\" alt=\"" + words +
           "\"><figcaption>" + words + "</figcaption></figure>\n";
}

class Page {
public:
    explicit Page(const Report& report)
        : report_(report),
          heat_(report.heat),
          differs_(!report.heat.at("other").is_null()) {}

    std::string html() {
        const std::string scene = text(heat_.at("scene"));
        page_ = head;
        page_ += "<title>Heat map of " + scene + "</title>\n</head>\n<body>\n<h1>Heat map of " +
                 scene + "</h1>\n<p class=\"command\"><code>" + escape_html(report_.command_line) +
                 "</code></p>\n";
        facts();
        checks();
        page_ += "<div class=\"pair\">\n";
        page_ += image(protocol::to_base64(report_.picture), "The view");
        page_ += image(heat_.at("file").at("base64").get<std::string>(), caption());
        page_ += "</div>\n";
        histogram();
        findings();
        ranking();
        statistics();
        page_ += "</body>\n</html>\n";
        return std::move(page_);
    }

private:
    std::string caption() const {
        return text(heat_.at("metric")) + " per ray" +
               (differs_ ? ", difference: red costs more than the other, blue less" : "") +
               (heat_.at("count") == "necessary" ? ", necessary only" : "");
    }

    /// Ends the headings of what a difference has of its first scene only.
    std::string alone() const {
        return differs_ ? " (" + text(heat_.at("scene")) + " epoch " + text(heat_.at("epoch")) +
                              ", " + text(heat_.at("intersector")) + " alone)"
                        : "";
    }

    void row(std::string_view name, const std::string& value) {
        page_ += "<dt>" + std::string(name) + "</dt><dd>" + value + "</dd>\n";
    }

    static std::string job_text(const Json& job) {
        const std::string settings = text(job.at("settings"));
        return text(job.at("scene")) + " epoch " + text(job.at("epoch")) + ", " +
               text(job.at("intersector")) + (settings.empty() ? "" : " " + settings) +
               selection_text(job, "hide") + selection_text(job, "only") + ", hash " +
               text(job.at("hash"));
    }

    /// ", hide inst=3" where the job hides something.
    static std::string selection_text(const Json& job, const char* key) {
        const std::string words = job.contains(key) ? text(job.at(key)) : "";
        return words.empty() ? "" : std::string(", ") + key + " " + words;
    }

    void facts() {
        page_ += "<dl>\n";
        row("Scene", job_text(heat_));
        if (differs_) row("Less that of", job_text(heat_.at("other")));
        row("Camera", text(heat_.at("camera")) + ", " + text(heat_.at("size")[0]) + " x " +
                          text(heat_.at("size")[1]) + ", " + whole(heat_.at("rays"), false) +
                          " rays");
        row("Geometry", whole(heat_.at("triangles"), false) + " triangles, " +
                            text(heat_.at("levels")) + " levels, " +
                            bytes_text(heat_.at("bytes").get<std::uint64_t>()));
        row("Made by", "RayNest " RAYNEST_VERSION ", target " + text(heat_.at("target")));
        page_ += "</dl>\n";
    }

    void checks() {
        if (report_.checks.empty()) return;
        page_ += "<h2>Limits</h2>\n<ul>\n";
        for (const Verdict& verdict : report_.checks)
            page_ += std::string("<li class=\"") + (verdict.exceeded ? "bad" : "good") + "\">" +
                     escape_html(verdict_text(verdict)) + "</li>\n";
        page_ += "</ul>\n";
    }

    void histogram() {
        const Json& histogram = heat_.at("histogram");
        const Json& bars = histogram.at("bars");
        std::uint64_t most = 1;
        for (const Json& bar : bars) most = std::max(most, bar.get<std::uint64_t>());
        constexpr double width = 1200, height = 160;
        page_ += "<h2>Histogram</h2>\n<p class=\"faint\">Pixels by " + caption() +
                 "; the height is logarithmic.</p>\n<svg viewBox=\"0 0 1200 184\" role=\"img\" "
                 "aria-label=\"Histogram\">\n";
        const double step = width / static_cast<double>(bars.size());
        for (std::size_t i = 0; i < bars.size(); ++i) {
            const auto count = bars[i].get<std::uint64_t>();
            if (count == 0) continue;
            const double tall = std::max(
                2.0, height * std::log1p(static_cast<double>(count)) /
                         std::log1p(static_cast<double>(most)));
            page_ += formatted("<rect x=\"%.1f\" y=\"%.1f\" ", static_cast<double>(i) * step,
                               height - tall) +
                     formatted("width=\"%.1f\" height=\"%.1f\"/>\n", step - 1, tall);
        }
        page_ += "<line x1=\"0\" y1=\"160\" x2=\"1200\" y2=\"160\"/>\n";
        const auto label = [&](double x, const char* anchor, const Json& value) {
            page_ += formatted("<text x=\"%.0f\" y=\"178\" ", x) + "text-anchor=\"" + anchor +
                     "\">" + whole(value, differs_) + "</text>\n";
        };
        label(0, "start", histogram.at("low"));
        label(width, "end", Json(histogram.at("high").get<std::int64_t>() - 1));
        page_ += "</svg>\n";
    }

    void findings() {
        page_ += "<h2>Diagnosis" + alone() + "</h2>\n";
        const Json& findings = report_.ranking.at("findings");
        if (findings.empty()) page_ += "<p>Nothing found.</p>\n";
        page_ += findings.empty() ? "" : "<ul>\n";
        for (const Json& finding : findings) {
            std::string name = finding.at("finding").get<std::string>();
            std::ranges::replace(name, '_', ' ');
            const std::string subject = text(finding.at("subject"));
            page_ += "<li><b>" + escape_html(name) + "</b>" +
                     (subject.empty() ? "" : " in " + subject) + subject_number(finding) + ": " +
                     formatted("%.3g", finding.at("figure").get<double>()) + " " +
                     text(finding.at("unit")) + ", should not be " + text(finding.at("side")) +
                     formatted(" %.3g", finding.at("threshold").get<double>()) + ". " +
                     percent(finding.at("share")) + " of all work. Remedy: " +
                     text(finding.at("remedy")) + ".</li>\n";
        }
        page_ += findings.empty() ? "" : "</ul>\n";
    }

    void ranking() {
        page_ += "<p class=\"faint\">Wasted: the part of a row's work on rays that hit nothing in "
                 "it. Work per ray: boxes and primitives tested by each ray that enters.</p>\n";
        table("Instances", "instances", "Path", "trees above");
        table("Meshes", "meshes", "Object", "trees of instances alone");
        table("Materials (primitives only)", "materials", "Number", "boxes");
    }

    void table(const char* title, const char* key, const char* number, const char* remainder) {
        const Json& part = report_.ranking.at(key);
        if (part.at("rows").empty()) return;
        page_ += std::string("<h2>") + title + alone() +
                 "</h2>\n<div class=\"scroll\"><table>\n<tr><th>Name</th><th>" + number +
                 "</th><th>Share of work</th><th>Wasted</th><th>Work per ray</th><th>Rays</th></tr>\n";
        for (const Json& row : part.at("rows")) {
            const Json& name = row.at("name");
            std::string words = name.is_null() ? "(none)" : text(name);
            if (words.empty())
                words = row.contains("index") ? "#" + row.at("index").dump() : "(without a name)";
            if (row.contains("mesh") && row.at("mesh") != name)
                words += " <span class=\"faint\">of mesh " + text(row.at("mesh")) + "</span>";
            page_ += "<tr><td>" + words + "</td><td>" + row_number(row) + "</td><td>" +
                     percent(row.at("share")) + "</td><td>" +
                     percent(row.at("wasted")) + "</td><td>" +
                     formatted("%.1f", row.at("work_per_ray").get<double>()) + "</td><td>" +
                     whole(row.at("rays"), false) + "</td></tr>\n";
        }
        const Json& others = part.at("others");
        if (others.at("rows") != 0)
            page_ += "<tr><td>" + whole(others.at("rows"), false) + " more</td><td></td><td>" +
                     percent(others.at("share")) + "</td><td></td><td></td><td></td></tr>\n";
        page_ += std::string("<tr><td>") + remainder + "</td><td></td><td>" +
                 percent(part.at("remainder").at("share")) +
                 "</td><td></td><td></td><td></td></tr>\n</table></div>\n";
    }

    void statistics() {
        page_ += std::string("<h2>Counters per ray") + (differs_ ? ", difference" : "") +
                 "</h2>\n<div class=\"scroll\"><table>\n<tr><th>Metric</th>"
                 "<th>min</th><th>mean</th><th>p50</th><th>p90</th><th>p99</th><th>max</th></tr>\n";
        for (const auto& [metric, row] : heat_.at("statistics").items()) {
            page_ += "<tr><td>" + escape_html(metric) + "</td><td>" +
                     whole(row.at("min"), differs_) + "</td><td>" +
                     formatted(differs_ ? "%+.2f" : "%.2f", row.at("mean").get<double>()) + "</td>";
            for (const char* key : {"p50", "p90", "p99", "max"})
                page_ += "<td>" + whole(row.at(key), differs_) + "</td>";
            page_ += "</tr>\n";
        }
        page_ += "</table></div>\n";
    }

    const Report& report_;
    const Json& heat_;
    const bool differs_;
    std::string page_;
};

}  // namespace

std::string escape_html(std::string_view text) {
    std::string escaped;
    for (const char c : text) {
        switch (c) {
            case '&':
                escaped += "&amp;";
                break;
            case '<':
                escaped += "&lt;";
                break;
            case '>':
                escaped += "&gt;";
                break;
            case '"':
                escaped += "&quot;";
                break;
            case '\'':
                escaped += "&#39;";
                break;
            default:
                escaped += c;
        }
    }
    return escaped;
}

std::string report_html(const Report& report) {
    return Page(report).html();
}

}  // namespace raynest::client
