// The interface of a kernel pack: C types only, so that a pack can be built outside this tree.
//
// A pack is one loadable module per target (x86-64-v2, -v3, -v4, cuda) that exports one symbol,
// raynest_pack(). Two reasons: the same template compiled with two -march flags in one binary is
// silently merged by the linker, and a user can compile an intersector of their own.
#pragma once

#include "engine/geometry/hit.h"
#include "engine/geometry/ray.h"
#include "engine/geometry/views.h"
#include "engine/intersectors/table.h"
#include "engine/packs/observer.h"

#include <cstdint>

namespace raynest {

inline constexpr std::uint32_t pack_abi = 10;

enum Query : std::uint32_t {
#define RAYNEST_KIND(name, ...) query_##name,
#include "engine/packs/words.def"
    query_count
};
/// `reference` walks every primitive with no BVH: the oracle, in the same pack and the same bits.
enum Traversal : std::uint32_t {
#define RAYNEST_TRAVERSAL(name, ...) traversal_##name,
#include "engine/packs/words.def"
    traversal_count,
    /// A request's word for: look at the rays (packs/kernel_selector.h)
    traversal_auto = traversal_count
};
enum ValueType : std::uint32_t { value_f32, value_u32, value_choice, value_table };
/// The counters that a trace function writes to TraceCall::counters.
enum CounterMode : std::uint32_t {
    counters_none,
    counters_total,     ///< one per ray
    counters_by_level,  ///< for each ray, one per level of the scene, the root's first
    counter_modes
};
enum TraceFlags : std::uint32_t { trace_cull_back = 1 };
enum TraceStatus : std::int32_t {
    trace_ok = 0,
    trace_bad_call = 1,
    trace_out_of_memory = 2,
    trace_too_deep = 3,   ///< the scene has more levels than the target takes; a CPU takes any
    trace_no_device = 4,  ///< no GPU, or it does not answer any more
    trace_cancelled = 5   ///< by TraceCall::cancelled; what was written means nothing
};

inline constexpr std::uint32_t multi_hits_max = 256;
inline constexpr std::uint32_t all_hits_max = 65536;
/// Values of all tables of a call.
inline constexpr std::uint32_t table_values_max = 8192;

/// A parameter of an intersector, set by request.
struct PackParam {
    const char* name;
    const char* text;
    ValueType type;
    std::uint32_t choice_count;
    const char* const* choices;  ///< for value_choice; the value is the index
    double minimum;              ///< for a table: each value's
    double maximum;
    double initial;  ///< for a table, which is empty then: 0
};

/// A per-ray output of an intersector; written for misses too. u32 or f32.
struct PackOutput {
    const char* name;
    const char* text;
    ValueType type;
};

/// One chunk of rays. Thread-safe as long as the output arrays are distinct.
struct TraceCall {
    const SceneView* scene;
    const double* params;  ///< one per PackParam, in order; null: all at their initial value. Of
                           ///< a table not read
    const Ray* rays;
    std::uint32_t ray_count;
    std::uint32_t hits_max;     ///< multi: capacity per ray, 1..multi_hits_max; all: budget per
                                ///< ray, 1..all_hits_max; else 1
    std::uint32_t mask;         ///< instances with (mask & theirs) == 0 are skipped
    std::uint32_t flags;        ///< TraceFlags
    HitRecord* hits;            ///< ray_count * hits_max; `any` sets hit and flags only; of `all`
                                ///< hits_room records, those of one ray after those of another
    std::uint32_t* hit_counts;  ///< multi, all: one per ray; else may be null
    Counters* counters;         ///< as the function's CounterMode says; else may be null
    void* const* outputs;  ///< one column of ray_count 4-byte values per PackOutput; may be null

    // For `all` only. Where the room ends within a ray, the call ends before it: the caller takes
    // the hits away and goes on with that ray. Room for twice the budget is enough for any.
    std::uint64_t hits_room = 0;         ///< at least 2 * hits_max
    std::uint8_t* ray_flags = nullptr;   ///< one per ray: HitFlags
    std::uint32_t* rays_done = nullptr;  ///< rays answered, from the first on

    /// On a CPU asked every so often, also within a ray; once it is true the call ends soon. May be
    /// null.
    bool (*cancelled)(const void* context) noexcept = nullptr;
    const void* cancelled_context = nullptr;

    /// One per PackParam of type value_table, in order; null: all are empty.
    const Table* tables = nullptr;

    const Observer* observer = nullptr;  ///< for PackVariant::observe; else not read

    const void* device = nullptr;  ///< set behind the interface of packs/device.h only
};

using TraceFunction = TraceStatus (*)(const TraceCall*) noexcept;

/// An intersector compiled for one target. Null where a combination was not compiled.
struct PackVariant {
    const char* name;
    const char* text;
    const PackParam* params;
    std::uint32_t param_count;
    std::uint32_t output_count;
    const PackOutput* outputs;
    TraceFunction trace[traversal_count][query_count][counter_modes];
    TraceFunction observe;  ///< single, closest, each step told to the call's observer
};

/// A primitive type beside triangles, as plain records.
struct PackPrimitive {
    const char* name;
    std::uint32_t record_size;
    std::uint32_t hits_max;
    /// Bounds of `count` records.
    void (*bounds)(const void* records, std::uint64_t count, Box* boxes) noexcept;
    /// Outward normal of one record at an object-space point, not normalised; null: none defined.
    void (*normal)(const void* record, const float point[3], float normal[3]) noexcept;
};

/// A type that both sides of the interface know, and a hash of its layout (packs/layout.h).
struct TypeLayout {
    const char* name;
    std::uint64_t hash;
};

/// The first three members and TypeLayout stay as they are in every version: they are read before
/// it is known whether the rest can be.
struct Pack {
    std::uint32_t abi;  ///< pack_abi
    std::uint32_t type_count;
    const TypeLayout* types;       ///< checked at load
    const char* target;            ///< "v2", "v3", "v4", "cuda"
    std::uint32_t kernel_count;    ///< compiled trace functions, for the build report
    bool (*supported)() noexcept;  ///< may this CPU run it?
    const PackVariant* variants;
    std::uint32_t variant_count;
    std::uint32_t primitive_count;
    const PackPrimitive* primitives;
};

inline constexpr const char* pack_symbol = "raynest_pack";
using PackEntry = const Pack* (*)() noexcept;

}  // namespace raynest
