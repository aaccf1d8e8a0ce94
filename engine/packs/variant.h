// The compiled functions of one intersector on a CPU: everything heavy is instantiated here, once
// per (intersector, target).
#pragma once

#include "engine/bvh/packet_traversal.h"
#include "engine/bvh/stream.h"
#include "engine/bvh/visit.h"
#include "engine/geometry/coherence.h"
#include "engine/intersectors/counting.h"
#include "engine/intersectors/each_once.h"
#include "engine/packs/abi.h"
#include "engine/packs/describe.h"
#include "engine/packs/observe.h"
#include "engine/packs/trace_io.h"
#include "engine/queries/queries.h"
#include "engine/queries/reference.h"

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <new>
#include <span>
#include <tuple>
#include <type_traits>

namespace raynest {

// ---- One chunk of rays --------------------------------------------------------------

/// Rays that are traced before their outputs are copied to columns: keeps per-ray state on the
/// stack and in L1, without an allocation. A stream is larger, because its last rays travel alone.
template <Traversal traversal>
inline constexpr std::uint32_t ray_group = traversal == traversal_stream ? 1024 : 64;

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

/// One ray from the root; with `Everything` by the reference, which knows no tree.
template <bool Everything, class Isect, class Query>
RAYNEST_INLINE void trace_one(RayView& view, const Bvh& root, Isect& isect, Query& query) {
    if constexpr (Everything) {
        brute_force(view, root, isect, query);
    } else {
        BoxRay ray(view);
        traverse(ray, root, isect, query);
    }
}

/// Guesses are for rays whose search ends with the nearest surface. Searches for any hit are short.
/// Where an intersector refuses surfaces the way on is long, and several nodes are better looked at
/// together: alpha masks on cards would have 0.90 of their rate. Nor may the order show in which an
/// intersector is asked.
template <class Isect, class Query>
inline constexpr bool guesses_pay =
    std::is_same_v<Query, ClosestHit> && !shows_order<Isect> && !Overrides<Isect, BoxRay, Boxes8> &&
    !Overrides<Isect, BoxRay, Triangles8>;

template <class Isect, class TraceIO, class With>
RAYNEST_INLINE void trace_lot(BoxRay* rays, std::uint32_t count, const Bvh& root, Isect& isect,
                              const TraceIO& io, With* with) {
    for (std::uint32_t r = 0; r < count; ++r) {
        const std::uint32_t number = rays[r].id;
        auto query = io.query_in_place(number);
        traverse(rays[r], root, isect, query, with);
        io.end(number, query);
    }
}

/// A call of its own, which keeps it from the code that most rays run.
template <class Isect, class TraceIO>
[[gnu::noinline]] void try_guesses(BoxRay* rays, std::uint32_t count, const Bvh& root, Isect& isect,
                                   const TraceIO& io) {
    trace_lot(rays, count, root, isect, io, io.guesses);
}

/// One ray after the other.
template <bool Everything, class Isect, class TraceIO>
RAYNEST_INLINE void trace_singly(const Bvh& root, std::uint32_t count, Isect& isect,
                                 const TraceIO& io) {
    if constexpr (Everything) {
        for (std::uint32_t i = 0; i < count; ++i) {
            RayView view;
            if (!io.begin(i, view)) continue;
            auto query = io.query(i);
            trace_one<true>(view, root, isect, query);
            io.end(i, query);
        }
    } else {
        // Some rays are set up before the first of them is traced: a CPU works on the divisions of
        // several at once, but not behind the mispredicted end of a search (measured: 2 %, of short
        // rays 4 %; 64 rays are as good as 16).
        constexpr std::uint32_t ahead_max = 16;
        alignas(BoxRay) std::byte memory[ahead_max][sizeof(BoxRay)];
        // The caller may cancel before each lot: asking it before each ray costs 2 %. In trees
        // that take a ray long, above 2 million triangles, lots are smaller; of so few rays as an
        // io thread traces each is one.
        constexpr std::int64_t work_max = 1 << 22;
        const std::int64_t work = work_in(root.record());
        const auto ahead = static_cast<std::uint32_t>(
            io.call.ray_count <= ray_group<traversal_single>
                ? 1
                : std::clamp<std::int64_t>(work_max / work, 1, ahead_max));
        for (std::uint32_t i = 0; i < count && !is_cancelled(io.cancellation, ahead * work);) {
            std::uint32_t ready = 0;
            for (; i < count && ready < ahead; ++i) {
                RayView view;
                if (io.begin(i, view)) new (memory[ready++]) BoxRay(view);
            }
            BoxRay* const rays = std::launder(reinterpret_cast<BoxRay*>(memory));
            if constexpr (guesses_pay<Isect, typename TraceIO::Query>) {
                const Box& bounds = root.record().bounds;
                const auto like_first = [&](std::uint32_t r) RAYNEST_INLINE_LAMBDA {
                    return are_alike(*rays[0].world, *rays[r].world, bounds);
                };
                if (ready > 1 && like_first(ready / 2) && like_first(ready - 1)) {
                    using enum TriedGuesses::Use;
                    const TriedGuesses::Use use = io.guesses->of_next_lot();
                    if (use == tried) {
                        try_guesses(rays, ready, root, isect, io);
                        continue;
                    }
                    if (use == taken) {
                        trace_lot(rays, ready, root, isect, io, static_cast<Guesses*>(io.guesses));
                        continue;
                    }
                }
            }
            trace_lot(rays, ready, root, isect, io, static_cast<std::nullptr_t*>(nullptr));
        }
    }
}

/// The traversal that a named one with a tree is.
///
/// The outputs of an intersector may depend on the order in which it is asked, so one that has them
/// goes through the single traversal whatever was named: same request, same bytes. One that
/// decides about boxes has to see each ray's own; packets test them together.
template <class Isect, Traversal named>
inline constexpr Traversal that_runs = has_outputs<Isect> || (named == traversal_packet &&
                                                              Overrides<Isect, BoxRay, Boxes8>)
                                           ? traversal_single
                                           : named;

template <Traversal traversal, class Isect, class TraceIO>
RAYNEST_INLINE TraceStatus trace_group(const Bvh& root, std::uint32_t count, Isect& isect,
                                       const TraceIO& io) {
    if constexpr (traversal == traversal_single || traversal == traversal_reference) {
        trace_singly<traversal == traversal_reference>(root, count, isect, io);
        return trace_ok;
    } else if constexpr (traversal == traversal_stream) {
        return StreamTraversal(root, isect, io).trace(count) ? trace_ok : trace_out_of_memory;
    } else {
        PacketTraversal<Isect, typename TraceIO::Query>(isect).trace(root, count, io);
        return trace_ok;
    }
}

template <class Isect, Query kind, Traversal traversal, CounterMode counted>
TraceStatus trace(const TraceCall* pointer) noexcept {
    const TraceCall& call = *pointer;
    const bool well_formed = call.scene != nullptr && call.rays != nullptr &&
                             call.hits != nullptr && call.hits_max >= 1 &&
                             call.hits_max <= multi_hits_max &&
                             (kind != query_multi || call.hit_counts != nullptr) &&
                             (counted == counters_none || call.counters != nullptr);
    if (!well_formed) return trace_bad_call;

    Isect isect = make_intersector<Isect>(call);
    const Bvh root{call.scene, call.scene->root};
    Cancellation cancellation(call.cancelled, call.cancelled_context);
    using Outputs = typename OutputsOf<Isect>::type;
    MemoryOf<Isect> memory;
    TriedGuesses guesses;
    constexpr std::uint32_t group = ray_group<traversal>;
    for (std::uint32_t first = 0; first < call.ray_count; first += group) {
        const std::uint32_t rest = call.ray_count - first;
        const std::uint32_t count = rest < group ? rest : group;
        const TraceIO<kind> io{call, first, &cancellation, &guesses};
        std::array<Outputs, group> states{};
        if constexpr (requires { isect.state = states.data(); }) isect.state = states.data();
        TraceStatus status = trace_ok;
        if constexpr (counted != counters_none) {
            constexpr bool by_level = counted == counters_by_level;
            const std::uint32_t sets = by_level ? root.record().levels : 1;
            Counters* counters = call.counters + std::size_t{first} * sets;
            std::fill_n(counters, std::size_t{count} * sets, Counters{});
            Counting<Isect, by_level> counting{isect, counters, sets};
            auto&& asked = each_once(counting, memory);
            status = trace_group<traversal>(root, count, asked, io);
        } else {
            auto&& asked = each_once(isect, memory);
            status = trace_group<traversal>(root, count, asked, io);
        }
        if (cancellation.was_seen()) return trace_cancelled;
        if (status != trace_ok) return status;
        if (memory.is_exhausted()) return trace_out_of_memory;
        write_outputs<Isect>(call, first, count, states.data());
    }
    return trace_ok;
}

/// All hits of one ray after the other, packed, for as long as there is room.
template <class Isect, Traversal traversal>
TraceStatus trace_all(const TraceCall* pointer) noexcept {
    const TraceCall& call = *pointer;
    const bool well_formed =
        call.scene != nullptr && call.rays != nullptr && call.hits != nullptr &&
        call.hit_counts != nullptr && call.ray_flags != nullptr && call.rays_done != nullptr &&
        call.hits_max >= 1 && call.hits_max <= all_hits_max && call.hits_room / 2 >= call.hits_max;
    if (!well_formed) return trace_bad_call;

    Isect isect = make_intersector<Isect>(call);
    const Bvh root{call.scene, call.scene->root};
    Cancellation cancellation(call.cancelled, call.cancelled_context);
    MemoryOf<Isect> memory;
    auto&& asked = each_once(isect, memory);
    std::span<HitRecord> room(call.hits, call.hits_room);
    std::uint32_t done = 0;
    for (; done < call.ray_count; ++done) {
        const Ray& ray = call.rays[done];
        const std::size_t most = std::min(room.size(), std::size_t{2} * call.hits_max);
        AllHits query{room.first(most), call.hits_max};
        query.cancellation = &cancellation;
        std::uint8_t flags = hit_invalid_ray;
        typename OutputsOf<Isect>::type state{};
        if constexpr (requires { isect.state = &state; }) isect.state = &state;
        if (is_cancelled(&cancellation, work_in(root.record()))) return trace_cancelled;
        if (is_valid(ray)) {
            RayView view = outermost_view(ray, call.scene, 0, call.mask, call.flags);
            view.object = &call.scene->objects[call.scene->root];
            trace_one<traversal == traversal_reference>(view, root, asked, query);
            if (cancellation.was_seen()) return trace_cancelled;
            if (memory.is_exhausted()) return trace_out_of_memory;
            if (!query.fits) break;
            query.finish();
            flags = query.truncated ? std::uint8_t{hit_truncated} : std::uint8_t{0};
        }
        call.hit_counts[done] = query.count;
        call.ray_flags[done] = flags;
        write_outputs<Isect>(call, done, 1, &state);
        room = room.subspan(query.count);
    }
    *call.rays_done = done;
    return trace_ok;
}

/// Closest hits of one ray after the other, each step told.
template <class Isect>
TraceStatus observe(const TraceCall* pointer) noexcept {
    const TraceCall& call = *pointer;
    if (call.scene == nullptr || call.rays == nullptr || call.hits == nullptr ||
        call.hits_max != 1 || call.observer == nullptr)
        return trace_bad_call;

    Isect isect = make_intersector<Isect>(call);
    const Bvh root{call.scene, call.scene->root};
    Cancellation cancellation(call.cancelled, call.cancelled_context);
    Watch watch{*call.observer};
    MemoryOf<Isect> memory;
    constexpr std::uint32_t group = ray_group<traversal_single>;
    for (std::uint32_t first = 0; first < call.ray_count; first += group) {
        const std::uint32_t count = std::min(call.ray_count - first, group);
        std::array<typename OutputsOf<Isect>::type, group> states{};
        if constexpr (requires { isect.state = states.data(); }) isect.state = states.data();
        Observing<Isect> observing{isect, watch};
        auto&& asked = each_once(observing, memory);
        trace_singly<false>(root, count, asked, ObservedIO{{call, first, &cancellation}, watch});
        if (cancellation.was_seen()) return trace_cancelled;
        if (memory.is_exhausted()) return trace_out_of_memory;
        write_outputs<Isect>(call, first, count, states.data());
    }
    return trace_ok;
}

// ---- The table ----------------------------------------------------------------------

/// The single traversal with each CounterMode.
template <class Isect, Query kind>
constexpr void add_counting(TraceFunction (&functions)[counter_modes]) {
    functions[counters_none] = trace<Isect, kind, traversal_single, counters_none>;
    functions[counters_total] = trace<Isect, kind, traversal_single, counters_total>;
    functions[counters_by_level] = trace<Isect, kind, traversal_single, counters_by_level>;
}

/// The kernels compiled per intersector: single {closest, any, multi} with each CounterMode and
/// plain {all}, observed closest hits, the reference, and except on v2 stream {closest, any, multi}
/// and packet {closest, any}. A new traversal is a few lines here.
template <class Isect>
constexpr PackVariant make_variant(const char* name) {
    PackVariant v = describe_variant<Isect>(name);
    v.observe = observe<Isect>;
    auto& kernels = v.trace;
    auto& single = kernels[traversal_single];
    add_counting<Isect, query_closest>(single[query_closest]);
    add_counting<Isect, query_any>(single[query_any]);
    add_counting<Isect, query_multi>(single[query_multi]);
    single[query_all][0] = trace_all<Isect, traversal_single>;
    if constexpr (Lanes<8>::parts == 1) {  // v2 is for correctness, not speed
        // KernelSelector tells what ran by the functions: those of single rays where they run
        // instead.
        constexpr Traversal streams = that_runs<Isect, traversal_stream>;
        auto& stream = kernels[traversal_stream];
        stream[query_closest][0] = trace<Isect, query_closest, streams, counters_none>;
        stream[query_any][0] = trace<Isect, query_any, streams, counters_none>;
        stream[query_multi][0] = trace<Isect, query_multi, streams, counters_none>;
        constexpr Traversal packets = that_runs<Isect, traversal_packet>;
        auto& packet = kernels[traversal_packet];
        packet[query_closest][0] = trace<Isect, query_closest, packets, counters_none>;
        packet[query_any][0] = trace<Isect, query_any, packets, counters_none>;
    }
    auto& reference = kernels[traversal_reference];
    reference[query_closest][0] = trace<Isect, query_closest, traversal_reference, counters_none>;
    reference[query_any][0] = trace<Isect, query_any, traversal_reference, counters_none>;
    reference[query_multi][0] = trace<Isect, query_multi, traversal_reference, counters_none>;
    reference[query_all][0] = trace_all<Isect, traversal_reference>;
    return v;
}

}  // namespace raynest
