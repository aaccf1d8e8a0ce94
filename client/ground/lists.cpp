#include "client/ground/lists.h"

#include <algorithm>

namespace raynest::client {
namespace {

template <class Has>
bool some_column(std::string_view name, Has has) {
    return std::any_of(column_words.begin(), column_words.end(), [&](const ColumnWords& column) {
        return column.name == name && has(column);
    });
}

}  // namespace

const ReducerWords* find_reducer(std::string_view name) {
    const auto* found = std::find_if(reducer_words.begin(), reducer_words.end(),
                                     [&](const ReducerWords& each) { return each.name == name; });
    return found == reducer_words.end() ? nullptr : found;
}

bool IntegratorWords::reads(std::string_view setting) const {
    return std::find(settings.begin(), settings.end(), setting) != settings.end();
}

const IntegratorWords* find_integrator(std::string_view name) {
    const auto* found =
        std::find_if(integrator_words.begin(), integrator_words.end(),
                     [&](const IntegratorWords& each) { return each.name == name; });
    return found == integrator_words.end() ? nullptr : found;
}

std::string for_integrators(std::string_view setting) {
    std::string names;
    for (const IntegratorWords& each : integrator_words)
        if (each.reads(setting)) names.append(names.empty() ? "" : ", ").append(each.name);
    return "for " + names + ": ";
}

bool has_splits(std::string_view kind) {
#define RAYNEST_KIND(name, hits, text) \
    if (kind == #name) return std::string_view(#hits) == "many";
#include "engine/packs/words.def"
    return false;
}

bool is_hit_field(std::string_view name) {
    return some_column(name, [](const ColumnWords& column) { return column.of == "hit"; });
}

bool is_point_field(std::string_view name) {
    return some_column(name, [](const ColumnWords& column) { return column.type == "point"; });
}

bool is_truth_field(std::string_view name) {
    return some_column(name, [](const ColumnWords& column) { return column.type == "truth"; });
}

std::vector<std::string> default_fields(std::string_view kind) {
    std::vector<std::string> names;
    for (const ColumnWords& column : column_words)
        if (column.shown == (kind == "any" ? "any" : "hits")) names.emplace_back(column.name);
    return names;
}

std::string known_fields() {
    std::string names;
    for (const ColumnWords& column : column_words) names.append(column.name).append(" ");
    for (const std::string_view counter : counter_words) names.append(counter).append(" ");
    names.pop_back();
    return names;
}

std::string alternatives(std::span<const std::string_view> words) {
    std::string text;
    for (const std::string_view word : words)
        text += (text.empty() ? "" : " | ") + std::string(word);
    return text;
}

}  // namespace raynest::client
