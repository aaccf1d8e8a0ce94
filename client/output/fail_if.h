// heatmap --fail-if: limits that a build sets to what rays cost, and what became of them.
#pragma once

#include "client/ground/failure.h"
#include "client/ground/json.h"

#include <span>
#include <string>
#include <vector>

namespace raynest::client {

/// A comparison that must not come true: total.p99>120.
struct FailIf {
    std::string text;        ///< as it was given
    std::string metric;      ///< total, boxes.1; or levels, bytes, triangles
    std::string statistic;   ///< min mean p50 p90 p99 max; empty for levels, bytes and triangles
    std::string comparison;  ///< > >= < <=
    double limit = 0;
};

/// Parses 'METRIC[.LEVEL].STATISTIC OP NUMBER' or 'levels|bytes|triangles OP NUMBER'.
[[nodiscard]] Result<FailIf> parse_fail_if(const std::string& text);

struct Verdict {
    FailIf check;
    double value = 0;
    bool exceeded = false;
};

/// Compares all checks with the document of a heat map. Exit code 2 where it lacks a metric.
[[nodiscard]] Result<std::vector<Verdict>> judge(std::span<const FailIf> checks,
                                                 const Json& document);

/// Returns [{"check", "value", "limit", "exceeded"}].
[[nodiscard]] Json verdicts_json(std::span<const Verdict> verdicts);
/// Returns "total.p99 is 131, above 120: exceeded".
[[nodiscard]] std::string verdict_text(const Verdict& verdict);
/// Exit code 9 if a limit is exceeded; the message has those values beside their limits.
Result<void> check_verdicts(std::span<const Verdict> verdicts);

}  // namespace raynest::client
