// Loads kernel packs and answers "which compiled function runs this request?".
#pragma once

#include "engine/packs/abi.h"
#include "engine/result.h"

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
};

/// One value per PackParam of the variant, in order.
using ParamValues = std::vector<double>;

/// Names of the CPU targets of pack.cmake, the best one last.
[[nodiscard]] std::span<const std::string_view> cpu_targets();

/// RAYNEST_BUILTIN_PACKS, else <dir of the binary>/../lib/raynest. A pack for GPUs lies beside it,
/// in raynest-cuda: who loads that one talks to a driver.
std::filesystem::path builtin_pack_directory();

/// Immutable after load; safe to share between threads. Packs stay loaded for its lifetime.
class Registry {
public:
    struct Options {
        std::vector<std::filesystem::path> pack_dirs;  ///< beside the built-in directory
        std::string target = "auto";                   ///< auto | v2 | v3 | v4 | cuda
    };
    /// Loads every pack of builtin_pack_directory(), `pack_dirs` and RAYNEST_PACK_PATH (colon
    /// separated). Fails when a pack does not load, when two packs of one target share a variant's
    /// name, when no variant is left, or when the forced target is unknown or not runnable here.
    static Result<std::shared_ptr<const Registry>> load(const Options& options);

    [[nodiscard]] std::span<const Variant> variants() const { return variants_; }
    /// null when unknown.
    [[nodiscard]] const Variant* find(std::string_view name) const;
    /// "auto" is alpha_mask where the scene has MASK or BLEND materials, else opaque.
    /// Also checks that the variant knows the scene's primitive types.
    [[nodiscard]] Result<const Variant*> choose(std::string_view name,
                                                const SceneView& scene) const;
    /// null when unknown. `hash` as primitive_type() gives it.
    [[nodiscard]] const PackPrimitive* find_primitive(std::uint32_t type) const;
    [[nodiscard]] const PackPrimitive* find_primitive(std::string_view name) const;
    [[nodiscard]] std::span<const Pack* const> packs() const { return packs_; }

private:
    Registry() = default;
    std::vector<const Pack*> packs_;
    std::vector<Variant> variants_;
};

/// Parameters that every variant takes, beside its own: `cull`.
std::span<const PackParam> common_params();

/// The settings that `--set` asks for, checked: a name the variant does not declare, a value out of
/// range or not in its choices gives param_invalid and the list of what is allowed.
/// `cull=back|none` is common to all variants and ends up in `flags` (TraceFlags).
struct Settings {
    ParamValues params;
    std::uint32_t flags = 0;
};
Result<Settings> parse_settings(const Variant& variant,
                                std::span<const std::pair<std::string, std::string>> assignments);

/// The function for a request, or variant_unknown naming what is missing.
Result<TraceFunction> find_function(const Variant& variant, Query query, Precision precision,
                                    Traversal traversal, CounterMode counters = counters_none);

Result<Query> parse_query(std::string_view name);          ///< a KIND of words.def
Result<Precision> parse_precision(std::string_view name);  ///< fast | watertight
/// auto, or a word of words.def
Result<Traversal> parse_traversal(std::string_view name);
/// The word of the above.
[[nodiscard]] const char* query_name(Query query);
[[nodiscard]] const char* traversal_name(Traversal traversal);

}  // namespace raynest
