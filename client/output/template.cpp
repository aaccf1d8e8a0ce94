#include "client/output/template.h"

#include "client/ground/text.h"
#include "client/output/ranking.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <deque>
#include <vector>

namespace raynest::client {
namespace {

std::string formatted_number(const char* format, double number) {
    std::array<char, 64> text{};
    std::snprintf(text.data(), text.size(), format, number);
    return text.data();
}

/// A count with its thousands apart; a difference with its sign.
std::string whole(const Json& value, bool differs) {
    const auto number = value.get<std::int64_t>();
    const std::string digits = grouped(static_cast<std::uint64_t>(std::abs(number)));
    return (number < 0 ? "-" : differs && number > 0 ? "+" : "") + digits;
}

/// The rectangles of a histogram of 1200 x 160.
Json bars_of(const Json& counts) {
    double most = 1;
    for (const Json& count : counts) most = std::max(most, count.get<double>());
    const double step = 1200.0 / static_cast<double>(counts.size());
    Json bars = Json::array();
    for (std::size_t i = 0; i < counts.size(); ++i) {
        const auto count = counts[i].get<double>();
        if (count == 0) continue;
        const double tall = std::max(2.0, 160 * std::log1p(count) / std::log1p(most));
        bars.push_back({{"x", formatted_number("%.2f", static_cast<double>(i) * step)},
                        {"y", formatted_number("%.1f", 160 - tall)},
                        {"width", formatted_number("%.2f", step - 1)},
                        {"height", formatted_number("%.1f", tall)}});
    }
    return bars;
}

std::string name_of(const Json& row) {
    const Json& name = row.at("name");
    if (name.is_null()) return "(none)";
    if (const auto text = name.get<std::string>(); !text.empty()) return text;
    return row.contains("index") ? "#" + row.at("index").dump() : "(without a name)";
}

/// "page.html#a" becomes text as it stands; numbers as JSON has them.
std::string text_of(const Json& value) {
    return value.is_null() ? "" : value.is_string() ? value.get<std::string>() : value.dump();
}

bool is_shown(const Json& value) {
    if (value.is_array()) return !value.empty();
    return !(value.is_null() || value == false || value == "");
}

class Filling {
public:
    Filling(std::string_view text, const Json& values) : stack_{&values} { fill(text); }

    std::string text() { return std::move(made_); }

private:
    void fill(std::string_view text) {
        while (true) {
            const std::size_t begin = text.find("{{");
            made_ += text.substr(0, begin);
            if (begin == std::string_view::npos) return;
            const std::size_t end = text.find("}}", begin);
            std::string_view word = text.substr(begin + 2, end - begin - 2);
            text.remove_prefix(end + 2);
            if (word.front() != '#' && word.front() != '^') {
                made_ += escape_html(text_of(value_of(word)));
                continue;
            }
            const bool inverted = word.front() == '^';
            word.remove_prefix(1);
            const std::string closing = "{{/" + std::string(word) + "}}";
            const std::size_t close = text.find(closing);
            section(word, text.substr(0, close), inverted);
            text.remove_prefix(close + closing.size());
        }
    }

    void section(std::string_view word, std::string_view inside, bool inverted) {
        const Json& value = value_of(word);
        if (inverted != is_shown(value)) {
            const bool each = value.is_array() && !inverted;
            for (std::size_t i = 0; i < (each ? value.size() : 1); ++i) {
                stack_.push_back(each ? &value[i] : &value);
                fill(inside);
                stack_.pop_back();
            }
        }
    }

    const Json& value_of(std::string_view word) {
        const std::size_t bar = word.find('|');
        const Json* value = find(word.substr(0, bar));
        while (word.find('|') != std::string_view::npos) {
            word.remove_prefix(word.find('|') + 1);
            kept_.push_back(filtered(*value, word.substr(0, word.find('|'))));
            value = &kept_.back();
        }
        return *value;
    }

    const Json* find(std::string_view path) const {
        static const Json none;
        if (path == ".") return stack_.back();
        for (auto at = stack_.rbegin(); at != stack_.rend(); ++at)
            if (const Json* found = below(*at, path)) return found;
        return &none;
    }

    static const Json* below(const Json* value, std::string_view path) {
        while (!path.empty()) {
            const std::string key(path.substr(0, path.find('.')));
            path.remove_prefix(std::min(path.size(), key.size() + 1));
            if (value->is_object() && value->contains(key))
                value = &value->at(key);
            else if (value->is_array() &&
                     key.find_first_not_of("0123456789") == std::string::npos &&
                     std::stoul(key) < value->size())
                value = &value->at(std::stoul(key));
            else
                return nullptr;
        }
        return value;
    }

    /// The filters. A difference is that of the whole document: see `delta`.
    Json filtered(const Json& value, std::string_view filter) const {
        if (filter.starts_with("is:")) return value == std::string(filter.substr(3));
        if (filter == "any") return !value.empty();
        if (filter == "positive") return value.is_number() && value.get<double>() > 0;
        if (value.is_null()) return nullptr;
        const bool differs = is_shown(*find("heat.other"));
        if (filter == "count") return whole(value, false);
        if (filter == "delta") return whole(value, differs);
        if (filter == "before") return value.get<std::int64_t>() - 1;
        if (filter == "bytes") return bytes_text(value.get<std::uint64_t>());
        if (filter == "percent") return formatted_number("%.1f %%", 100 * value.get<double>());
        if (filter == "one") return formatted_number("%.1f", value.get<double>());
        if (filter == "two")
            return formatted_number(differs ? "%+.2f" : "%.2f", value.get<double>());
        if (filter == "three") {
            const auto number = value.get<double>();
            return formatted_number(std::abs(number) >= 100 ? "%.0f" : "%.3g", number);
        }
        if (filter == "bars") return bars_of(value);
        if (filter == "name") return name_of(value);
        if (filter == "number") return row_number(value);
        if (filter == "about") return subject_number(value);
        if (filter == "of_mesh")
            return value.contains("mesh") && value.at("mesh") != value.at("name") ? value.at("mesh")
                                                                                  : Json();
        if (filter == "words") {
            std::string text = value.get<std::string>();
            std::ranges::replace(text, '_', ' ');
            return text;
        }
        if (filter != "entries") std::abort();  // a template of this tree names no other
        Json entries = Json::array();
        for (const auto& [key, entry] : value.items())
            entries.push_back({{"key", key}, {"value", entry}});
        return entries;
    }

    std::vector<const Json*> stack_;  ///< values of the sections around, innermost last
    std::deque<Json> kept_;           ///< what filters made; sections point to it
    std::string made_;
};

}  // namespace

std::string fill_template(std::string_view text, const Json& values) {
    return Filling(text, values).text();
}

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

}  // namespace raynest::client
