// Loads kernel packs and answers "which compiled function runs this request?".
#pragma once

#include "engine/packs/abi.h"
#include "engine/result.h"

#include <algorithm>
#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace raynest {

/// One intersector with the best of its targets that this CPU runs.
struct Variant {
    const PackVariant* code = nullptr;  ///< on `target`
    std::string name;
    std::string text;
    std::string target;
    std::vector<std::string> targets;         ///< all loaded packs that have it, best first
    std::vector<std::uint32_t> record_types;  ///< primitive types its pack can meet
    [[nodiscard]] std::span<const PackParam> params() const {
        return {code->params, code->param_count};
    }
    [[nodiscard]] std::span<const PackOutput> outputs() const {
        return {code->outputs, code->output_count};
    }
    /// Can it meet this primitive type?
    [[nodiscard]] bool knows(std::uint32_t type) const {
        return std::find(record_types.begin(), record_types.end(), type) != record_types.end();
    }
};

/// One value per PackParam of the variant, in order.
using ParamValues = std::vector<double>;

/// The values of one parameter that is a table.
struct NamedTable {
    std::string name;
    std::vector<float> values;
};

/// The tables of a variant, as a call takes them: one per parameter that is a table, in order.
class Tables {
public:
    explicit Tables(std::vector<std::vector<float>> values);
    Tables(const Tables&) = delete;
    Tables& operator=(const Tables&) = delete;

    [[nodiscard]] const std::vector<std::vector<float>>& values() const { return values_; }
    [[nodiscard]] const Table* data() const { return views_.data(); }

private:
    std::vector<std::vector<float>> values_;
    std::vector<Table> views_;
};

/// The lowest target whose kernels give the same bits as those of `target`: v2 has no FMA and rounds
/// products that all others, the GPU's too, do not (math/vec.h).
[[nodiscard]] std::string_view arithmetic_of(std::string_view target);

/// Names of the CPU targets of targets.def, the best one last.
[[nodiscard]] std::span<const std::string_view> cpu_targets();

/// RAYNEST_BUILTIN_PACKS, else <dir of the binary>/../lib/raynest. A pack for GPUs lies beside it,
/// in raynest-cuda: who loads that one talks to a driver.
std::filesystem::path builtin_pack_directory();

/// Immutable after load; safe to share between threads. Packs stay loaded for its lifetime.
class Registry {
public:
    struct Options {
        std::vector<std::filesystem::path> pack_dirs;  ///< beside `packs`
        std::string target = "auto";                   ///< auto | v2 | v3 | v4 | cuda
        std::filesystem::path packs = {};  ///< RayNest's own; empty: builtin_pack_directory()
    };
    /// Loads every pack of `packs`, `pack_dirs` and RAYNEST_PACK_PATH (colon separated). Fails when
    /// a pack does not load or declares what no request could name (declarations.h), when two packs
    /// of one target share a variant's name, when no variant is left, or when the forced target is
    /// unknown or not runnable here.
    static Result<std::shared_ptr<const Registry>> load(const Options& options);

    [[nodiscard]] std::span<const Variant> variants() const { return variants_; }
    /// null when unknown.
    [[nodiscard]] const Variant* find(std::string_view name) const;
    /// "auto" is alpha_mask where the scene has MASK materials, else opaque; where that does
    /// not know the scene's primitive types, the first variant of their packs' lists that does.
    /// Fails when the named variant, or every one, lacks a type.
    [[nodiscard]] Result<const Variant*> choose(std::string_view name,
                                                const SceneView& scene) const;
    /// null when unknown. `type` as primitive_type() gives it.
    [[nodiscard]] const PackPrimitive* find_primitive(std::uint32_t type) const;
    [[nodiscard]] const PackPrimitive* find_primitive(std::string_view name) const;
    [[nodiscard]] std::span<const Pack* const> packs() const { return packs_; }

private:
    Registry() = default;
    void add_variants(const Pack& pack);
    /// Fails when the variant lacks a primitive type of the scene, or knows it with another size.
    [[nodiscard]] Result<void> check_types(const Variant& variant, const SceneView& scene) const;
    [[nodiscard]] std::string advice_for(std::uint32_t type) const;

    std::vector<const Pack*> packs_;
    std::vector<Variant> variants_;
};

/// Parameters that every variant takes, beside its own: `cull`.
std::span<const PackParam> common_params();

/// The settings that `--set` asks for, checked: a name the variant does not declare, a value out of
/// range or not in its choices gives param_invalid and the list of what is allowed. So does a table
/// for a parameter that is none, and one with a value out of range.
/// `cull=back|none` is common to all variants and ends up in `flags` (TraceFlags).
struct Settings {
    ParamValues params;
    std::shared_ptr<const Tables> tables;  ///< null: all are empty
    std::uint32_t flags = 0;

    /// Sets `params`, `tables` and `flags` of a call, which must end before these settings.
    void apply_to(TraceCall& call) const;
    [[nodiscard]] bool operator==(const Settings& other) const;
};
Result<Settings> parse_settings(const Variant& variant,
                                std::span<const std::pair<std::string, std::string>> assignments,
                                std::span<const NamedTable> tables = {});

/// The function for a request, or variant_unknown naming what is missing.
Result<TraceFunction> find_function(const Variant& variant, Query query, Traversal traversal,
                                    CounterMode counters = counters_none);

Result<Query> parse_query(std::string_view name);  ///< a KIND of words.def
/// auto, or a word of words.def
Result<Traversal> parse_traversal(std::string_view name);
/// The word of the above.
[[nodiscard]] const char* query_name(Query query);
[[nodiscard]] const char* traversal_name(Traversal traversal);

}  // namespace raynest
