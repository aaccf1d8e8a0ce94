// Limits of --fail-if, the header of an EXR, differences, and reports.
#include "client/files/exr_header.h"
#include "client/ground/json.h"
#include "client/output/fail_if.h"
#include "client/output/report.h"
#include "client/requests/difference.h"

#include <doctest/doctest.h>

#include <array>
#include <cstring>
#include <string>
#include <vector>

using namespace raynest::client;

namespace {

std::string fail_if_complaint(const std::string& text) {
    const auto parsed = parse_fail_if(text);
    REQUIRE_FALSE(parsed.has_value());
    CHECK(parsed.error().exit == Exit::usage);
    return parsed.error().message;
}

Json small_document(const std::string& scene) {
    Json document = Json::parse(R"({
        "hash": "ab", "epoch": 1, "intersector": "opaque", "settings": "", "mask": 1,
        "target": "v3", "other": null, "camera": "<b>", "size": [4, 2], "rays": 8, "levels": 2,
        "bytes": 1000, "triangles": 12, "metric": "total", "count": "traversed", "range": [0, 9],
        "clipped": 0, "below": 0, "histogram": {"low": 0, "high": 10, "bars": [7, 0, 1]},
        "statistics": {"total": {"min": 0, "mean": 2.5, "p50": 2, "p90": 8, "p99": 9, "max": 9},
                       "boxes.1": {"min": 0, "mean": 1, "p50": 1, "p90": 2, "p99": 3, "max": 4}},
        "file": {"encode": "png", "width": 4, "height": 2, "base64": "iVBORw=="}})");
    document["scene"] = scene;
    return document;
}

/// Appends an attribute as an EXR header has it.
void append(std::string& file, const std::string& name, const std::string& type,
            const std::string& value) {
    const auto size = static_cast<std::uint32_t>(value.size());
    std::array<char, 4> bytes;
    std::memcpy(bytes.data(), &size, bytes.size());
    file += name + '\0' + type + '\0' + std::string(bytes.data(), bytes.size()) + value;
}

auto texts_of(const std::string& file) {
    return read_exr_texts(std::as_bytes(std::span(file)));
}

}  // namespace

TEST_CASE("a limit names a metric, perhaps a level, and a statistic") {
    const auto total = parse_fail_if("total.p99>120");
    REQUIRE(total.has_value());
    CHECK(total->metric == "total");
    CHECK(total->statistic == "p99");
    CHECK(total->comparison == ">");
    CHECK(total->limit == 120);
    const auto level = parse_fail_if(" boxes.1.mean  <= -2.5e1 ");
    REQUIRE(level.has_value());
    CHECK(level->metric == "boxes.1");
    CHECK(level->statistic == "mean");
    CHECK(level->comparison == "<=");
    CHECK(level->limit == -25);
    const auto bytes = parse_fail_if("bytes>=1000");
    REQUIRE(bytes.has_value());
    CHECK(bytes->metric == "bytes");
    CHECK(bytes->statistic.empty());
}

TEST_CASE("a limit that does not parse is told with what it lacks") {
    CHECK(fail_if_complaint("total.p99").find("none of > >= < <=") != std::string::npos);
    CHECK(fail_if_complaint("").find("none of") != std::string::npos);
    CHECK(fail_if_complaint(">5").find("METRIC.STATISTIC") != std::string::npos);
    CHECK(fail_if_complaint("total>5").find("METRIC.STATISTIC") != std::string::npos);
    CHECK(fail_if_complaint("total.p98>5").find("statistics are min | mean") != std::string::npos);
    CHECK(fail_if_complaint("cost.p99>5").find("no metric 'cost'") != std::string::npos);
    for (const char* text : {"total.p99>", "total.p99>x", "total.p99>5x", "total.p99>nan",
                             "total.p99>inf", "total.p99>>5"})
        CHECK(fail_if_complaint(text).find("a number") != std::string::npos);
}

TEST_CASE("all limits are judged, and the exceeded ones are named with value and limit") {
    const Json document = small_document("scene");
    std::vector<FailIf> checks;
    for (const char* text : {"total.p99>8", "total.p99>9", "total.p99>=9", "boxes.1.max<5",
                             "total.mean<=2.4", "levels>2", "bytes>999", "triangles>12"})
        checks.push_back(*parse_fail_if(text));
    const auto verdicts = judge(checks, document);
    REQUIRE(verdicts.has_value());
    std::vector<bool> exceeded;
    for (const Verdict& verdict : *verdicts) exceeded.push_back(verdict.exceeded);
    CHECK(exceeded == std::vector<bool>{true, false, true, true, false, false, true, false});
    const auto result = check_verdicts(*verdicts);
    REQUIRE_FALSE(result.has_value());
    CHECK(result.error().exit == Exit::threshold);
    CHECK(result.error().message.find("4 of 8 limits exceeded: total.p99 is 9, above 8: exceeded; "
                                      "total.p99 is 9, at or above 9") != std::string::npos);
    CHECK(check_verdicts(std::span(*verdicts).first(0)).has_value());
    CHECK(verdict_text((*verdicts)[1]) == "total.p99 is 9, not above 9: ok");

    const auto missing = judge(std::array{*parse_fail_if("boxes.7.max>1")}, document);
    REQUIRE_FALSE(missing.has_value());
    CHECK(missing.error().exit == Exit::usage);
    CHECK(missing.error().message.find("levels are 0 to 1") != std::string::npos);
}

TEST_CASE("the texts of an EXR header are read, and a damaged one is refused") {
    std::string file = {'\x76', '\x2f', '\x31', '\x01', '\x02', '\0', '\0', '\0'};
    append(file, "channels", "chlist", std::string(40, '\0'));
    append(file, "raynest:range", "string", "0:412");
    append(file, "raynest:metric", "string", "total");
    file += '\0';
    file += "pixels";
    const auto texts = texts_of(file);
    REQUIRE(texts.has_value());
    CHECK(texts->at("raynest:range") == "0:412");
    CHECK(texts->count("channels") == 0);
    for (std::size_t size = 0; size < file.size() - 7; ++size)
        CHECK_FALSE(texts_of(file.substr(0, size)).has_value());
    std::string huge = file;
    const std::size_t at = huge.find("0:412") - 4;
    std::memset(&huge[at], 0xFF, 4);
    CHECK_FALSE(texts_of(huge).has_value());
}

TEST_CASE("a difference is another scene, or options and parameters that differ") {
    JobOptions job;
    job.scene = "forest";
    job.epoch = 3;
    job.settings = {"cutoff=0.5", "cull=back"};
    Difference setting;
    REQUIRE(read_difference("cutoff=0.3", setting).has_value());
    REQUIRE(read_difference("mask=F", setting).has_value());
    JobOptions other = other_job(job, setting);
    CHECK(other.settings == std::vector<std::string>{"cull=back", "cutoff=0.3"});
    CHECK(other.mask == 0xF);
    CHECK(other.epoch == 3);
    Difference variant;
    REQUIRE(read_difference("intersector=opaque", variant).has_value());
    other = other_job(job, variant);
    CHECK(other.intersector == "opaque");
    CHECK(other.settings.empty());
    Difference scene;
    REQUIRE(read_difference("builtin:forest?trees=3", scene).has_value());
    CHECK(scene.scene == "builtin:forest?trees=3");
    other = other_job(job, scene);
    CHECK(other.epoch == 0);
    CHECK(other.settings == job.settings);
    CHECK_FALSE(read_difference("a second", scene).has_value());
    for (const char* text : {"traversal=packet", "worker=cpu", "=3", "cutoff=", "mask=xyz",
                             "epoch=0", "epoch=x", "cutoff=0.4"}) {
        CAPTURE(text);
        const auto read = read_difference(text, setting);
        REQUIRE_FALSE(read.has_value());
        CHECK(read.error().exit == Exit::usage);
    }
}

TEST_CASE("a report shows names as text and needs nothing from elsewhere") {
    const std::string hostile = "<img src=x onerror=alert(1)>\"'&";
    Report report;
    report.heat = small_document(hostile);
    report.command_line = "raynest heatmap '" + hostile + "'";
    Json row =
        Json::parse(R"({"mesh": "", "share": 0.5, "wasted": 0.1, "work_per_ray": 3, "rays": 4})");
    row["name"] = hostile;
    row["mesh"] = "</td><script>alert(2)</script>";
    Json part =
        Json::parse(R"({"others": {"rows": 2, "share": 0.1}, "remainder": {"share": 0.4}})");
    part["rows"] = Json::array({row});
    report.ranking = {{"instances", part}, {"meshes", part}, {"materials", part}};
    report.ranking["findings"] = Json::array({Json{{"finding", "thin_triangles"},
                                                   {"subject", hostile},
                                                   {"share", 0.5},
                                                   {"figure", 0.01},
                                                   {"unit", "x"},
                                                   {"side", "below"},
                                                   {"threshold", 0.1},
                                                   {"remedy", "cut"}}});
    const std::string html = report_html(report);
    CHECK(html.find("<img src=x") == std::string::npos);
    CHECK(html.find("<script") == std::string::npos);
    CHECK(html.find("&lt;img src=x onerror=alert(1)&gt;&quot;&#39;&amp;") != std::string::npos);
    for (const char* from_elsewhere : {"http://", "https://", "src=\"//", "url(", "@import"})
        CHECK(html.find(from_elsewhere) == std::string::npos);
    CHECK(html.find("data:image/png;base64,iVBORw==") != std::string::npos);
    CHECK(html.find("default-src 'none'") != std::string::npos);
}
