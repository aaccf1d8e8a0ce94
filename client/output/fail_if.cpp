#include "client/output/fail_if.h"

#include "client/ground/lists.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <string_view>

namespace raynest::client {
namespace {

constexpr std::array statistic_words = {std::string_view("min"), std::string_view("mean"),
                                        std::string_view("p50"), std::string_view("p90"),
                                        std::string_view("p99"), std::string_view("max")};
/// Numbers of a scene, by their keys in the document.
constexpr std::array scene_words = {std::string_view("levels"), std::string_view("bytes"),
                                    std::string_view("triangles")};

bool among(std::span<const std::string_view> words, std::string_view word) {
    return std::ranges::find(words, word) != words.end();
}

std::string_view trimmed(std::string_view text) {
    while (!text.empty() && text.front() == ' ') text.remove_prefix(1);
    while (!text.empty() && text.back() == ' ') text.remove_suffix(1);
    return text;
}

std::string figure_text(double value) {
    std::array<char, 32> text{};
    std::snprintf(text.data(), text.size(), "%.10g", value);
    return text.data();
}

bool compare(double value, const std::string& comparison, double limit) {
    if (comparison == ">") return value > limit;
    if (comparison == ">=") return value >= limit;
    if (comparison == "<") return value < limit;
    return value <= limit;
}

std::string words_of(const std::string& comparison) {
    if (comparison == ">") return "above";
    if (comparison == ">=") return "at or above";
    if (comparison == "<") return "below";
    return "at or below";
}

/// Splits total.p99 or boxes.1.p99 at its last point, and checks the names.
Result<void> read_subject(std::string_view subject, FailIf& check) {
    if (among(scene_words, subject)) {
        check.metric = subject;
        return {};
    }
    const std::size_t point = subject.rfind('.');
    if (point != std::string_view::npos) {
        check.metric = subject.substr(0, point);
        check.statistic = subject.substr(point + 1);
    }
    if (!among(statistic_words, check.statistic))
        return fail(Exit::usage, "'" + check.text + "' does not begin with METRIC.STATISTIC, as " +
                                     "total.p99, METRIC.LEVEL.STATISTIC, or one of " +
                                     alternatives(scene_words) + "; statistics are " +
                                     alternatives(statistic_words));
    const std::string_view name = std::string_view(check.metric).substr(0, check.metric.find('.'));
    if (!among(metric_words, name))
        return fail(Exit::usage, "'" + check.text + "': there is no metric '" + std::string(name) +
                                     "'; known: " + alternatives(metric_words));
    return {};
}

}  // namespace

Result<FailIf> parse_fail_if(const std::string& text) {
    FailIf check;
    check.text = text;
    const std::size_t at = text.find_first_of("<>");
    if (at == std::string::npos)
        return fail(Exit::usage, "'" + text + "' has none of > >= < <=, as in total.p99>120");
    const bool equal = at + 1 < text.size() && text[at + 1] == '=';
    check.comparison = text.substr(at, equal ? 2 : 1);
    const std::string_view whole = text;
    if (auto read = read_subject(trimmed(whole.substr(0, at)), check); !read)
        return tl::unexpected<Failure>(read.error());
    const std::string_view digits = trimmed(whole.substr(at + check.comparison.size()));
    const auto [end, error] =
        std::from_chars(digits.data(), digits.data() + digits.size(), check.limit);
    if (error != std::errc{} || end != digits.data() + digits.size() || !std::isfinite(check.limit))
        return fail(Exit::usage, "'" + text + "' does not end in a number");
    return check;
}

Result<std::vector<Verdict>> judge(std::span<const FailIf> checks, const Json& document) {
    std::vector<Verdict> verdicts;
    const Json& statistics = document.at("statistics");
    for (const FailIf& check : checks) {
        Verdict verdict{check, 0, false};
        if (check.statistic.empty()) {
            verdict.value = document.at(check.metric).get<double>();
        } else if (const auto row = statistics.find(check.metric); row != statistics.end()) {
            verdict.value = row->at(check.statistic).get<double>();
        } else if (check.metric.find('.') == std::string::npos) {
            return fail(Exit::usage, "'" + check.text + "': this heat map has no '" + check.metric +
                                         "'; ask for it with --metric " + check.metric);
        } else {
            return fail(Exit::usage,
                        "'" + check.text + "': there is no '" + check.metric + "' in scene '" +
                            document.at("scene").get<std::string>() + "', whose levels are 0 to " +
                            std::to_string(document.at("levels").get<std::int64_t>() - 1));
        }
        verdict.exceeded = compare(verdict.value, check.comparison, check.limit);
        verdicts.push_back(verdict);
    }
    return verdicts;
}

Json verdicts_json(std::span<const Verdict> verdicts) {
    Json json = Json::array();
    for (const Verdict& verdict : verdicts)
        json.push_back(Json{{"check", verdict.check.text},
                            {"value", verdict.value},
                            {"limit", verdict.check.limit},
                            {"exceeded", verdict.exceeded}});
    return json;
}

std::string verdict_text(const Verdict& verdict) {
    const FailIf& check = verdict.check;
    return check.metric + (check.statistic.empty() ? "" : "." + check.statistic) + " is " +
           figure_text(verdict.value) + (verdict.exceeded ? ", " : ", not ") +
           words_of(check.comparison) + " " + figure_text(check.limit) +
           (verdict.exceeded ? ": exceeded" : ": ok");
}

Result<void> check_verdicts(std::span<const Verdict> verdicts) {
    std::string texts;
    std::size_t count = 0;
    for (const Verdict& verdict : verdicts) {
        if (!verdict.exceeded) continue;
        ++count;
        texts += (texts.empty() ? "" : "; ") + verdict_text(verdict);
    }
    if (count == 0) return {};
    return fail(Exit::threshold, std::to_string(count) + " of " + std::to_string(verdicts.size()) +
                                     (verdicts.size() == 1 ? " limit" : " limits") +
                                     " exceeded: " + texts);
}

}  // namespace raynest::client
