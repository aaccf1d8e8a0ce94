// From an intersector's type to the C table of compiled functions: everything heavy is instantiated
// here, once per (intersector, target).
#pragma once

#include "engine/bvh/visit.h"
#include "engine/intersectors/counting.h"
#include "engine/intersectors/params.h"
#include "engine/packs/abi.h"
#include "engine/queries/queries.h"
#include "engine/queries/reference.h"

#include <array>
#include <cstddef>
#include <cstdint>
#include <new>
#include <span>
#include <tuple>
#include <type_traits>

namespace raynest {

// ---- Declarations of an intersector as C descriptors -------------------------------------------

template <class Owner>
constexpr PackParam describe(const Param<Owner, float>& p, const Owner& initial) {
    return {p.name,
            p.text,
            value_f32,
            0,
            nullptr,
            static_cast<double>(p.minimum),
            static_cast<double>(p.maximum),
            static_cast<double>(initial.*p.member)};
}
template <class Owner>
constexpr PackParam describe(const Param<Owner, std::uint32_t>& p, const Owner& initial) {
    return {p.name,
            p.text,
            value_u32,
            0,
            nullptr,
            static_cast<double>(p.minimum),
            static_cast<double>(p.maximum),
            static_cast<double>(initial.*p.member)};
}
template <class Owner, class T, std::size_t N>
constexpr PackParam describe(const Choice<Owner, T, N>& p, const Owner& initial) {
    return {p.name,
            p.text,
            value_choice,
            N,
            p.choices.data(),
            0.0,
            static_cast<double>(N - 1),
            static_cast<double>(initial.*p.member)};
}
template <class Owner>
constexpr PackOutput describe(const Output<Owner, float>& o) {
    return {o.name, o.text, value_f32};
}
template <class Owner>
constexpr PackOutput describe(const Output<Owner, std::uint32_t>& o) {
    return {o.name, o.text, value_u32};
}

template <class Isect>
constexpr auto describe_params() {
    if constexpr (requires { Isect::params; }) {
        return std::apply(
            [](const auto&... p) {
                return std::array<PackParam, sizeof...(p)>{
                    describe(p, typename Isect::Params{})...};
            },
            Isect::params);
    } else {
        return std::array<PackParam, 0>{};
    }
}

template <class Isect>
constexpr auto describe_outputs() {
    if constexpr (requires { Isect::outputs; }) {
        return std::apply(
            [](const auto&... o) { return std::array<PackOutput, sizeof...(o)>{describe(o)...}; },
            Isect::outputs);
    } else {
        return std::array<PackOutput, 0>{};
    }
}

// ---- One chunk of rays
// ---------------------------------------------------------------------------

/// Rays that are traced before their outputs are copied to columns: keeps per-ray state on the
/// stack and in L1, without an allocation.
inline constexpr std::uint32_t ray_group = 64;

template <class Isect>
Isect make_intersector(const TraceCall& call) {
    if constexpr (requires { typename Isect::Params; }) {
        typename Isect::Params values;
        if (call.params != nullptr) {
            const double* from = call.params;
            const auto assign = [&](const auto& p) {
                auto& member = values.*p.member;
                using T = std::remove_reference_t<decltype(member)>;
                if constexpr (std::is_enum_v<T>) {
                    member = static_cast<T>(static_cast<std::uint32_t>(*from++));
                } else {
                    member = static_cast<T>(*from++);
                }
            };
            std::apply([&](const auto&... p) { (assign(p), ...); }, Isect::params);
        }
        return Isect(*call.scene, values);
    } else {
        return Isect{};
    }
}

struct NoOutputs {};
template <class Isect>
struct OutputsOf {
    using type = NoOutputs;
};
template <class Isect>
requires requires {
    typename Isect::Outputs;
}
struct OutputsOf<Isect> {
    using type = typename Isect::Outputs;
};

/// Copies the outputs of rays [first, first + count) to the call's columns.
template <class Isect>
void write_outputs(const TraceCall& call, std::uint32_t first, std::uint32_t count,
                   const typename OutputsOf<Isect>::type* states) {
    if constexpr (requires { Isect::outputs; }) {
        if (call.outputs == nullptr) return;
        std::size_t column = 0;
        const auto copy = [&](const auto& o) {
            using T = std::remove_cvref_t<decltype(states->*o.member)>;
            T* to = static_cast<T*>(call.outputs[column++]) + first;
            for (std::uint32_t i = 0; i < count; ++i) to[i] = states[i].*o.member;
        };
        std::apply([&](const auto&... o) { (copy(o), ...); }, Isect::outputs);
    }
}

/// Traces one ray. `Everything` takes the place of the tree by the brute-force reference.
template <bool Everything, class Isect, class Query>
RAYNEST_INLINE void trace_ray(const RayView& view, const Bvh& root, Isect& isect, Query& query) {
    if constexpr (Everything) {
        RayView ray = view;
        visit_everything(ray, root, isect, query);
    } else {
        BoxRay ray(view);
        traverse(ray, root, isect, query);
    }
}

template <Query kind, bool Everything, class Isect>
RAYNEST_INLINE void answer_ray(const TraceCall& call, std::uint32_t index, std::uint32_t id,
                               const Bvh& root, Isect& isect) {
    const Ray& ray = call.rays[index];
    HitRecord* out = call.hits + static_cast<std::size_t>(index) * call.hits_max;
    if (!is_valid(ray)) {
        *out = HitRecord{};
        out->flags = hit_invalid_ray;
        if constexpr (kind == query_multi) call.hit_counts[index] = 0;
        return;
    }
    RayView view = outermost_view(ray, call.scene, id, call.mask, call.flags);
    view.object = &root.record();
    if constexpr (kind == query_closest) {
        ClosestHit query;
        trace_ray<Everything>(view, root, isect, query);
        *out = query.best;
    } else if constexpr (kind == query_any) {
        AnyHit query;
        trace_ray<Everything>(view, root, isect, query);
        *out = HitRecord{};
        out->hit = query.found ? 1 : 0;
    } else {
        MultiHit query{std::span(out, call.hits_max)};
        *out = HitRecord{};
        trace_ray<Everything>(view, root, isect, query);
        call.hit_counts[index] = query.count;
    }
}

template <class Isect, Query kind, bool Everything, bool Counted>
TraceStatus trace(const TraceCall* pointer) noexcept {
    const TraceCall& call = *pointer;
    const bool well_formed = call.scene != nullptr && call.rays != nullptr &&
                             call.hits != nullptr && call.hits_max >= 1 &&
                             call.hits_max <= multi_hits_max &&
                             (kind != query_multi || call.hit_counts != nullptr) &&
                             (!Counted || call.counters != nullptr);
    if (!well_formed) return trace_bad_call;

    Isect isect = make_intersector<Isect>(call);
    const Bvh root{call.scene, call.scene->root};
    using Outputs = typename OutputsOf<Isect>::type;
    for (std::uint32_t first = 0; first < call.ray_count; first += ray_group) {
        const std::uint32_t rest = call.ray_count - first;
        const std::uint32_t count = rest < ray_group ? rest : ray_group;
        std::array<Outputs, ray_group> states{};
        if constexpr (requires { isect.state = states.data(); }) isect.state = states.data();
        if constexpr (Counted) {
            Counters* counters = call.counters + first;
            for (std::uint32_t i = 0; i < count; ++i) counters[i] = Counters{};
            Counting<Isect> counting{isect, counters};
            for (std::uint32_t i = 0; i < count; ++i) {
                answer_ray<kind, Everything>(call, first + i, i, root, counting);
            }
        } else {
            for (std::uint32_t i = 0; i < count; ++i) {
                answer_ray<kind, Everything>(call, first + i, i, root, isect);
            }
        }
        write_outputs<Isect>(call, first, count, states.data());
    }
    return trace_ok;
}

// ---- The table
// -----------------------------------------------------------------------------------

/// What is compiled per intersector (CONTRACT.md §3): latency {closest, any, multi} x {plain,
/// counting}, and the reference. A new traversal or precision is a line here.
template <class Isect>
inline constexpr auto described_params = describe_params<Isect>();
template <class Isect>
inline constexpr auto described_outputs = describe_outputs<Isect>();

template <class Isect>
constexpr PackVariant make_variant(const char* name) {
    constexpr const auto& params = described_params<Isect>;
    constexpr const auto& outputs = described_outputs<Isect>;
    PackVariant v{};
    v.name = name;
    v.text = Isect::text;
    v.params = params.data();
    v.param_count = static_cast<std::uint32_t>(params.size());
    v.outputs = outputs.data();
    v.output_count = static_cast<std::uint32_t>(outputs.size());
    auto& latency = v.trace[precision_fast][traversal_latency];
    latency[query_closest][0] = trace<Isect, query_closest, false, false>;
    latency[query_closest][1] = trace<Isect, query_closest, false, true>;
    latency[query_any][0] = trace<Isect, query_any, false, false>;
    latency[query_any][1] = trace<Isect, query_any, false, true>;
    latency[query_multi][0] = trace<Isect, query_multi, false, false>;
    latency[query_multi][1] = trace<Isect, query_multi, false, true>;
    auto& reference = v.trace[precision_fast][traversal_reference];
    reference[query_closest][0] = trace<Isect, query_closest, true, false>;
    reference[query_any][0] = trace<Isect, query_any, true, false>;
    reference[query_multi][0] = trace<Isect, query_multi, true, false>;
    return v;
}

}  // namespace raynest
