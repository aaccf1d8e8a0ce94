// Names and values of a request -> what a pack takes.
#include "engine/packs/registry.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <sstream>

namespace raynest {
namespace {

std::string describe_range(const PackParam& param) {
    std::ostringstream text;
    if (param.type == value_choice) {
        for (std::uint32_t i = 0; i < param.choice_count; ++i) {
            text << (i != 0 ? ", " : "") << param.choices[i];
        }
    } else if (param.type == value_u32) {
        text << "a whole number from " << static_cast<std::uint32_t>(param.minimum) << " to "
             << static_cast<std::uint32_t>(param.maximum);
    } else {
        text << "a number from " << param.minimum << " to " << param.maximum;
    }
    return text.str();
}

Result<double> parse_value(const PackParam& param, const std::string& text) {
    if (param.type == value_choice) {
        for (std::uint32_t i = 0; i < param.choice_count; ++i) {
            if (text == param.choices[i]) return i;
        }
    } else {
        double value = 0;
        const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
        const bool whole = param.type != value_u32 || std::floor(value) == value;
        // A float's bounds are floats: 0.001 must not lose against 0.001F.
        const double rounded =
            param.type == value_f32 ? static_cast<double>(static_cast<float>(value)) : value;
        if (error == std::errc() && end == text.data() + text.size() && whole &&
            rounded >= param.minimum && rounded <= param.maximum) {
            return value;
        }
    }
    return fail(ErrorCode::param_invalid, std::string("'") + text + "' is no value for '" +
                                              param.name + "': use " + describe_range(param));
}

constexpr std::array<const char*, query_count> query_names = {
#define RAYNEST_KIND(name, ...) #name,
#include "engine/packs/words.def"
};
constexpr std::array<const char*, precision_count> precision_names = {"fast", "watertight"};
constexpr std::array<const char*, traversal_count + 1> traversal_names = {
#define RAYNEST_TRAVERSAL(name, word, text) word,
#include "engine/packs/words.def"
    "auto"};

/// The value whose name stands at its place.
template <class T, std::size_t N>
Result<T> parse_name(std::string_view what, std::string_view name,
                     const std::array<const char*, N>& known) {
    const auto* const found = std::find(known.begin(), known.end(), name);
    if (found != known.end()) return static_cast<T>(found - known.begin());
    std::string names;
    for (const char* each : known) names += (names.empty() ? "" : ", ") + std::string(each);
    return fail(ErrorCode::param_invalid, "unknown " + std::string(what) + " '" +
                                              std::string(name) + "': use one of " + names);
}

}  // namespace

std::span<const PackParam> common_params() {
    static constexpr const char* sides[] = {"none", "back"};
    static constexpr PackParam params[] = {{"cull",
                                            "faces that are not hit: none, or the back of "
                                            "single-sided materials",
                                            value_choice, 2, sides, 0, 1, 0}};
    return params;
}

Result<Settings> parse_settings(const Variant& variant,
                                std::span<const std::pair<std::string, std::string>> assignments) {
    Settings settings;
    for (const PackParam& param : variant.params()) settings.params.push_back(param.initial);
    for (const auto& [key, value] : assignments) {
        const PackParam& cull = common_params().front();
        if (key == cull.name) {
            const auto side = parse_value(cull, value);
            if (!side) return tl::unexpected(side.error());
            settings.flags = *side != 0 ? std::uint32_t{trace_cull_back} : 0U;
            continue;
        }
        const auto params = variant.params();
        std::size_t i = 0;
        while (i < params.size() && key != params[i].name) ++i;
        if (i == params.size()) {
            std::string names = cull.name;
            for (const PackParam& param : params) names += std::string(", ") + param.name;
            return fail(ErrorCode::param_invalid, "intersector '" + variant.name +
                                                      "' has no parameter '" + key +
                                                      "'; it has: " + names);
        }
        const auto parsed = parse_value(params[i], value);
        if (!parsed) return tl::unexpected(parsed.error());
        settings.params[i] = *parsed;
    }
    return settings;
}

Result<TraceFunction> find_function(const Variant& variant, Query query, Precision precision,
                                    Traversal traversal, CounterMode counters) {
    const TraceFunction function = variant.code->trace[precision][traversal][query][counters];
    if (function != nullptr) return function;
    std::string others;
    for (std::size_t other = 0; other < traversal_count; ++other) {
        if (variant.code->trace[precision][other][query][counters] != nullptr)
            others += (others.empty() ? "" : ", ") + std::string(traversal_names[other]);
    }
    if (!others.empty())
        return fail(ErrorCode::variant_unknown,
                    "kind " + std::string(query_names[query]) + " of intersector '" + variant.name +
                        "' has no traversal " + traversal_name(traversal) + "; it has " + others +
                        ": leave `traversal` auto");
    return fail(ErrorCode::variant_unknown,
                "intersector '" + variant.name + "' on target " + variant.target +
                    " was not compiled for query " + query_names[query] + ", precision " +
                    precision_names[precision] + ", traversal " + traversal_name(traversal) +
                    (counters != counters_none ? ", counters" : "") + ": try `traversal` auto");
}

Result<Query> parse_query(std::string_view name) {
    return parse_name<Query>("query kind", name, query_names);
}

Result<Precision> parse_precision(std::string_view name) {
    return parse_name<Precision>("precision", name, precision_names);
}

Result<Traversal> parse_traversal(std::string_view name) {
    constexpr std::array<std::array<std::string_view, 2>, 3> renamed = {
        {{"latency", "single"}, {"batch", "stream"}, {"coherent", "packet"}}};
    for (const auto& [old_word, word] : renamed) {
        if (name == old_word) {
            return fail(ErrorCode::param_invalid, "traversal '" + std::string(name) +
                                                      "' is called " + std::string(word));
        }
    }
    return parse_name<Traversal>("traversal", name, traversal_names);
}

const char* query_name(Query query) {
    return query_names[query];
}

const char* traversal_name(Traversal traversal) {
    return traversal_names[traversal];
}

}  // namespace raynest
