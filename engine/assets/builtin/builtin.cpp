// builtin:NAME?key=value&...: the table of procedural scenes and the parser for their keys.
#include "engine/assets/builtin/builtin.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <charconv>
#include <span>
#include <vector>

namespace raynest {
namespace {

constexpr BuiltinKey forest_keys[] = {{"trees", 1000, 1, 4'000'000}, {"leaves", 14, 1, 200},
                                      {"levels", 4, 1, 4},           {"wind", 0, 0, 3},
                                      {"seconds", 6, 1, 60},         {"seed", 1, 0, 1ULL << 53}};
constexpr BuiltinKey terrain_keys[] = {{"size", 512, 2, 8192}, {"seed", 1, 0, 1ULL << 53}};
constexpr BuiltinKey flake_keys[] = {{"depth", 6, 1, 16}};
constexpr BuiltinKey street_keys[] = {{"cars", 50, 0, 100'000},
                                      {"length", 400, 50, 100'000},
                                      {"seconds", 0, 0, 60},
                                      {"seed", 1, 0, 1ULL << 53}};

struct Builtin {
    std::string_view name;
    std::span<const BuiltinKey> keys;
    Result<SceneDescription> (*describe)(const BuiltinValues&);
};
constexpr Builtin builtins[] = {{"forest", forest_keys, describe_forest},
                                {"terrain", terrain_keys, describe_terrain},
                                {"flake", flake_keys, describe_flake},
                                {"street", street_keys, describe_street}};

std::string key_list(const Builtin& builtin) {
    std::vector<std::string> texts;
    for (const BuiltinKey& key : builtin.keys) {
        texts.push_back(fmt::format("{} ({}..{}, default {})", key.name, key.minimum, key.maximum,
                                    key.initial));
    }
    return fmt::format("{}", fmt::join(texts, ", "));
}

/// Stores one "key=value" in `values`, which hold the keys given so far. Returns false if the key
/// is unknown or repeated, or the value is out of range.
bool assign(const Builtin& builtin, std::string_view assignment, BuiltinValues& values) {
    const std::size_t equals = assignment.find('=');
    if (equals == std::string_view::npos) return false;
    const std::string_view text = assignment.substr(equals + 1);
    for (const BuiltinKey& key : builtin.keys) {
        if (key.name != assignment.substr(0, equals)) continue;
        std::uint64_t value = 0;
        const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
        if (error != std::errc{} || end != text.data() + text.size()) return false;
        return values.emplace(key.name, value).second && value >= key.minimum &&
               value <= key.maximum;
    }
    return false;
}

}  // namespace

Result<SceneDescription> describe_builtin(std::string_view source) {
    constexpr std::string_view prefix = "builtin:";
    if (source.starts_with(prefix)) source.remove_prefix(prefix.size());
    const std::string_view name = source.substr(0, source.find('?'));
    for (const Builtin& builtin : builtins) {
        if (builtin.name != name) continue;
        BuiltinValues values;
        std::string_view rest = source.substr(std::min(name.size() + 1, source.size()));
        while (!rest.empty()) {
            const std::string_view assignment = rest.substr(0, rest.find('&'));
            if (!assign(builtin, assignment, values)) {
                return fail(ErrorCode::scene_invalid,
                            fmt::format("builtin:{} does not take '{}'; it takes "
                                        "each of these keys once: {}",
                                        name, assignment.substr(0, 60), key_list(builtin)));
            }
            rest.remove_prefix(std::min(assignment.size() + 1, rest.size()));
        }
        for (const BuiltinKey& key : builtin.keys) values.emplace(key.name, key.initial);
        return builtin.describe(values);
    }
    std::vector<std::string> known;
    for (const Builtin& builtin : builtins)
        known.push_back(fmt::format("builtin:{} with {}", builtin.name, key_list(builtin)));
    return fail(ErrorCode::scene_invalid,
                fmt::format("there is no built-in scene '{}'; there are {}", name.substr(0, 60),
                            fmt::join(known, "; ")));
}

}  // namespace raynest
