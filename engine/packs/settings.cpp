// Names and values of a request -> what a pack takes.
#include "engine/packs/registry.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <memory>
#include <sstream>
#include <utility>

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
    if (param.type == value_table)
        return fail(ErrorCode::param_invalid, std::string("'") + param.name +
                                                  "' is a table: bring its values from a file or "
                                                  "an array");
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

Result<std::size_t> place_of(const Variant& variant, std::string_view name) {
    const auto params = variant.params();
    const auto found = std::find_if(params.begin(), params.end(),
                                    [&](const PackParam& param) { return name == param.name; });
    if (found != params.end()) return static_cast<std::size_t>(found - params.begin());
    std::string names = common_params().front().name;
    for (const PackParam& param : params) names += std::string(", ") + param.name;
    return fail(ErrorCode::param_invalid, "intersector '" + variant.name + "' has no parameter '" +
                                              std::string(name) + "'; it has: " + names);
}

Result<void> check_table(const PackParam& param, const NamedTable& table) {
    if (param.type != value_table)
        return fail(ErrorCode::param_invalid,
                    "'" + table.name + "' is no table: use " + describe_range(param));
    const auto bad = std::find_if(table.values.begin(), table.values.end(), [&](float value) {
        return !(static_cast<double>(value) >= param.minimum &&
                 static_cast<double>(value) <= param.maximum);
    });
    if (bad == table.values.end()) return {};
    std::ostringstream text;
    text << "value " << bad - table.values.begin() << " of table '" << table.name << "' is " << *bad
         << ": use " << describe_range(param) << " for each";
    return fail(ErrorCode::param_invalid, text.str());
}

Result<std::shared_ptr<const Tables>> read_tables(const Variant& variant,
                                                  std::span<const NamedTable> tables) {
    std::vector<const NamedTable*> given(variant.params().size());
    std::size_t values = 0;
    for (const NamedTable& table : tables) {
        if (const PackParam& cull = common_params().front(); table.name == cull.name)
            return tl::unexpected(check_table(cull, table).error());
        const auto i = place_of(variant, table.name);
        if (!i) return tl::unexpected(i.error());
        if (auto sound = check_table(variant.params()[*i], table); !sound)
            return tl::unexpected(sound.error());
        if (std::exchange(given[*i], &table) != nullptr)
            return fail(ErrorCode::param_invalid, "table '" + table.name + "' comes twice");
        values += table.values.size();
    }
    if (values > table_values_max)
        return fail(ErrorCode::limit_exceeded,
                    "the tables have " + std::to_string(values) +
                        " values, over table_values_max = " + std::to_string(table_values_max));
    if (values == 0) return nullptr;
    std::vector<std::vector<float>> all;
    for (std::size_t i = 0; i < given.size(); ++i) {
        if (variant.params()[i].type == value_table)
            all.push_back(given[i] == nullptr ? std::vector<float>() : given[i]->values);
    }
    return std::make_shared<const Tables>(std::move(all));
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

Tables::Tables(std::vector<std::vector<float>> values) : values_(std::move(values)) {
    for (const std::vector<float>& each : values_)
        views_.push_back({each.data(), static_cast<std::uint32_t>(each.size())});
}

void Settings::apply_to(TraceCall& call) const {
    call.params = params.empty() ? nullptr : params.data();
    call.tables = tables == nullptr ? nullptr : tables->data();
    call.flags = flags;
}

bool Settings::operator==(const Settings& other) const {
    const bool same_tables =
        tables == other.tables || (tables != nullptr && other.tables != nullptr &&
                                   tables->values() == other.tables->values());
    return params == other.params && flags == other.flags && same_tables;
}

Result<Settings> parse_settings(const Variant& variant,
                                std::span<const std::pair<std::string, std::string>> assignments,
                                std::span<const NamedTable> tables) {
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
        const auto i = place_of(variant, key);
        if (!i) return tl::unexpected(i.error());
        const auto parsed = parse_value(variant.params()[*i], value);
        if (!parsed) return tl::unexpected(parsed.error());
        settings.params[*i] = *parsed;
    }
    auto read = read_tables(variant, tables);
    if (!read) return tl::unexpected(read.error());
    settings.tables = std::move(*read);
    return settings;
}

Result<TraceFunction> find_function(const Variant& variant, Query query, Traversal traversal,
                                    CounterMode counters) {
    const TraceFunction function = variant.code->trace[traversal][query][counters];
    if (function != nullptr) return function;
    std::string others;
    for (std::size_t other = 0; other < traversal_count; ++other) {
        if (variant.code->trace[other][query][counters] != nullptr)
            others += (others.empty() ? "" : ", ") + std::string(traversal_names[other]);
    }
    if (!others.empty())
        return fail(ErrorCode::variant_unknown,
                    "kind " + std::string(query_names[query]) + " of intersector '" + variant.name +
                        "' has no traversal " + traversal_name(traversal) + "; it has " + others +
                        ": leave `traversal` auto");
    return fail(ErrorCode::variant_unknown,
                "intersector '" + variant.name + "' on target " + variant.target +
                    " was not compiled for query " + query_names[query] + ", traversal " +
                    traversal_name(traversal) + (counters != counters_none ? ", counters" : "") +
                    ": try `traversal` auto");
}

Result<Query> parse_query(std::string_view name) {
    return parse_name<Query>("query kind", name, query_names);
}

Result<Traversal> parse_traversal(std::string_view name) {
    constexpr std::array<std::array<std::string_view, 2>, 3> renamed = {
        {{"latency", "single"}, {"batch", "stream"}, {"coherent", "packet"}}};
    for (const auto& [old_word, word] : renamed) {
        if (name == old_word) {
            return fail(ErrorCode::param_invalid,
                        "traversal '" + std::string(name) + "' is called " + std::string(word));
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
