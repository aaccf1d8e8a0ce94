// Lists of words for help texts, and the columns of answers. The daemon checks requests: a word
// that is missing here is sent all the same.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <type_traits>
#include <vector>

namespace raynest::client {

inline constexpr std::array kind_words = {
#define RAYNEST_KIND(name, ...) std::string_view(#name),
#define RAYNEST_UNTRACED(name, ...) std::string_view(#name),
#include "engine/packs/words.def"
};
inline constexpr std::array traversal_words = {
    std::string_view("auto"),
#define RAYNEST_TRAVERSAL(name, word, text) std::string_view(word),
#include "engine/packs/words.def"
};
inline constexpr std::array metric_words = {
#define RAYNEST_COUNTER(name, title) std::string_view(#name),
#include "engine/geometry/counters.def"
#define RAYNEST_MEASURE(name, title) std::string_view(#name),
#include "engine/integrators/measures.def"
};
inline constexpr std::array counter_words = {
#define RAYNEST_COUNTER(name, title) std::string_view(#name),
#include "engine/geometry/counters.def"
};
inline constexpr std::array palette_words = {
#define RAYNEST_PALETTE(name, ...) std::string_view(#name),
#include "engine/integrators/palettes.def"
};
struct IntegratorWords {
    std::string_view name;
    std::string_view text;
    bool lit;                                  ///< auto exposure suits it
    std::array<std::string_view, 8> settings;  ///< that it reads
    [[nodiscard]] bool reads(std::string_view setting) const;
};
inline constexpr std::array integrator_words = {
#define RAYNEST_INTEGRATOR(name, Type, lit, text, ...) \
    IntegratorWords{#name, text, lit, {__VA_ARGS__}},
#include "engine/integrators/integrators.def"
};
/// Returns the integrator of this name, or null: primary is none.
[[nodiscard]] const IntegratorWords* find_integrator(std::string_view name);
/// Returns "for a, b: " of the integrators that read a setting.
[[nodiscard]] std::string for_integrators(std::string_view setting);

/// The settings of integrators that are numbers; 0: the daemon's.
struct SettingNumbers {
#define RAYNEST_INTEGRATOR_SETTING(name, type, ...) type name = 0;
#include "engine/integrators/integrator_settings.def"
};
/// The words of one of them.
struct SettingWords {
    std::string_view name;
    std::string_view option;
    std::string_view otherwise;  ///< what stands for 0
    std::string_view text;
    double least, most;      ///< of what is given
    std::string_view range;  ///< "a whole number from LEAST to MOST"
};
/// Calls use(words, object.setting...) for each setting; the objects have members of their names.
template <class Use, class... Objects>
void each_setting(const Use& use, Objects&... objects) {
#define RAYNEST_INTEGRATOR_SETTING(name, type, option, label, least, most, initial, otherwise,     \
                                   text)                                                           \
    use(SettingWords{#name, option, otherwise, text, least, most,                                  \
                     std::is_floating_point_v<type> ? "a number from " #least " to " #most         \
                                                    : "a whole number from " #least " to " #most}, \
        objects.name...);
#include "engine/integrators/integrator_settings.def"
}

inline constexpr std::array tonemap_words = {
#define RAYNEST_TONEMAP(name, text) std::string_view(#name),
#include "engine/integrators/tonemaps.def"
};

inline constexpr std::array worker_words = {
#define RAYNEST_AUTO(name, text) std::string_view(#name),
#define RAYNEST_WORKER(name, text) std::string_view(#name),
#include "protocol/lists/workers.def"
};

struct ReducerWords {
    std::string_view name;
    std::string_view kind;     ///< default kind of the query
    std::string_view rows;     ///< points | found
    std::string_view columns;  ///< "path u64, pixels u32"
};
inline constexpr std::array reducer_words = {
#define RAYNEST_REDUCER(name, kind, rows, columns, text) ReducerWords{#name, #kind, #rows, columns},
#include "protocol/lists/reducers.def"
};
inline constexpr std::array reduce_words = {
#define RAYNEST_REDUCER(name, ...) std::string_view(#name),
#include "protocol/lists/reducers.def"
};
/// Returns the reducer of this name, or null.
[[nodiscard]] const ReducerWords* find_reducer(std::string_view name);

struct ColumnWords {
    std::string_view name;
    std::string_view type;   ///< a point is relative to the scene's origin
    std::string_view of;     ///< hit | ray
    std::string_view shown;  ///< hits | any | asked
};
inline constexpr std::array column_words = {
#define RAYNEST_FIELD(name, type, of, reads, shown, text) ColumnWords{#name, #type, #of, #shown},
#include "engine/queries/fields.def"
};

/// True for kinds in which a ray may have any number of hits.
[[nodiscard]] bool has_splits(std::string_view kind);
/// True for a column of hits (t, prim, ...), false for one of rays (counters, flags, outputs).
[[nodiscard]] bool is_hit_field(std::string_view name);
/// True for a column of points, which are sent relative to the scene's origin.
[[nodiscard]] bool is_point_field(std::string_view name);

/// True for a field that says yes or no: bool in NumPy's files.
[[nodiscard]] bool is_truth_field(std::string_view name);
/// Returns the columns of a query that names none.
[[nodiscard]] std::vector<std::string> default_fields(std::string_view kind);

/// Returns "hit t prim ...", with counters at the end.
[[nodiscard]] std::string known_fields();

/// Returns "a | b | c".
[[nodiscard]] std::string alternatives(std::span<const std::string_view> words);

}  // namespace raynest::client
