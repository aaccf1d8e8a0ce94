// Names and values of a request -> what a pack takes.
#include "engine/packs/registry.h"

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

template <class T, std::size_t N>
Result<T> parse_name(std::string_view what, std::string_view name,
                     const std::pair<std::string_view, T> (&known)[N]) {
    std::string names;
    for (const auto& [text, value] : known) {
        if (text == name) return value;
        names += (names.empty() ? "" : ", ") + std::string(text);
    }
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
                                    Traversal traversal, bool counting) {
    const TraceFunction function =
        variant.code->trace[precision][traversal][query][counting ? 1 : 0];
    if (function != nullptr) return function;
    static constexpr const char* queries[] = {"closest", "any", "multi", "all"};
    static constexpr const char* precisions[] = {"fast", "watertight"};
    static constexpr const char* traversals[] = {"latency", "batch", "coherent", "reference"};
    return fail(ErrorCode::variant_unknown,
                "intersector '" + variant.name + "' on target " + variant.target +
                    " was not compiled for query " + queries[query] + ", precision " +
                    precisions[precision] + ", traversal " + traversals[traversal] +
                    (counting ? ", counters" : "") + ": try traversal auto");
}

Result<Query> parse_query(std::string_view name) {
    static constexpr std::pair<std::string_view, Query> known[] = {
        {"closest", query_closest}, {"any", query_any}, {"multi", query_multi}, {"all", query_all}};
    return parse_name("query kind", name, known);
}

Result<Precision> parse_precision(std::string_view name) {
    static constexpr std::pair<std::string_view, Precision> known[] = {
        {"fast", precision_fast}, {"watertight", precision_watertight}};
    return parse_name("precision", name, known);
}

Result<Traversal> parse_traversal(std::string_view name) {
    static constexpr std::pair<std::string_view, Traversal> known[] = {
        {"auto", traversal_auto},
        {"latency", traversal_latency},
        {"batch", traversal_batch},
        {"coherent", traversal_coherent},
        {"reference", traversal_reference}};
    return parse_name("traversal", name, known);
}

}  // namespace raynest
