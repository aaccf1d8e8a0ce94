// The single traversal of closest hits with an observer: the same templates as without one.
//
// `Observing` is the intersector that traversal sees, `ObservedClosest` its query. Between them a
// candidate is first judged by the intersector, then by culling, then against the best hit.
#pragma once

#include "engine/bvh/visit.h"
#include "engine/packs/describe.h"
#include "engine/packs/observer.h"
#include "engine/packs/trace_io.h"

#include <cstddef>
#include <cstdint>
#include <type_traits>

namespace raynest {

/// The state that the intersector and the query of one call share.
struct Watch {
    const Observer& observer;
    std::uint32_t survivors = 0;  ///< lanes of the last primitives that the intersector accepted

    void tell(const Step& step) const { observer.step(observer.context, &step); }
};

[[nodiscard]] inline Step step_of(StepKind kind, const RayView& ray) {
    Step step;
    step.kind = kind;
    step.object = static_cast<std::uint32_t>(ray.object - ray.scene->objects);
    step.path = ray.path;
    return step;
}

/// Tells the candidates in the lanes of `mask`; `why(surface)` gives the words.
template <class H, class Why>
void tell_candidates(const Watch& watch, const RayView& ray, const H& hits, std::uint32_t mask,
                     StepOutcome outcome, Why&& why) {
    H some = hits;
    some.mask = mask;
    some.keep_if([&](const Surface& surface) {
        Step step = step_of(step_candidate, ray);
        step.outcome = outcome;
        step.place = surface.prim;
        step.t = surface.t;
        step.u = surface.u;
        step.v = surface.v;
        step.front = surface.front ? 1 : 0;
        step.refusal = why(surface);
        watch.tell(step);
        return true;
    });
}

inline Refusal no_words(const Surface& /*surface*/) {
    return {};
}

/// Tells the questions to `Base`, and answers what it answers.
template <class Base>
struct Observing {
    Base& base;
    Watch& watch;

    auto operator()(const auto& ray, const BoxLike auto& boxes) {
        auto spans = intersect_with(base, ray, boxes);
        Step step = step_of(step_node, ray);
        step.place =
            static_cast<std::uint32_t>(boxes.node - ray.scene->nodes - ray.object->first_node);
        step.tested = boxes.valid();
        step.passed = spans.mask;
        if constexpr (Overrides<Base, decltype(ray), decltype(boxes)>)
            step.rejected = intersect(ray, boxes).mask & ~spans.mask;
        alignas(32) float nears[std::remove_cvref_t<decltype(spans)>::lane_count];
        spans.near.store(nears);
        step.nears = nears;
        watch.tell(step);
        return spans;
    }

    auto operator()(const auto& ray, const PrimitiveLike auto& primitive) {
        auto hits = intersect_with(base, ray, primitive);
        auto candidates = hits;
        if constexpr (Overrides<Base, decltype(ray), decltype(primitive)>)
            candidates = intersect(ray, primitive);
        Step step = step_of(step_primitives, ray);
        step.place = place_of(ray, primitive);
        step.tested = primitive.valid();
        step.passed = hits.mask;
        step.rejected = candidates.mask & ~hits.mask;
        step.first = primitive.first ? 1 : 0;
        watch.tell(step);
        watch.survivors = hits.mask;
        if (watch.observer.candidates != 0) {
            std::remove_cvref_t<decltype(ray)> unbounded = ray;
            unbounded.tmax = search_end(*ray.world);
            const auto all = intersect(unbounded, primitive);
            tell_candidates(watch, ray, all, all.mask & ~candidates.mask, outcome_behind, no_words);
            tell_candidates(watch, ray, candidates, step.rejected, outcome_refused,
                            [&](const Surface& surface) -> Refusal {
                                if constexpr (requires { base.refusal(ray, surface); }) {
                                    return base.refusal(ray, surface);
                                } else {
                                    return {};
                                }
                            });
        }
        return hits;
    }

    bool operator()(const auto& ray, const InstanceLike auto& instance) {
        const bool entered = enters(base, ray, instance);
        tell_instance(ray, instance, entered ? outcome_accepted : outcome_refused);
        return entered;
    }
    /// The instance and the ray have no bit in common (bvh/visit.h).
    void passes_by(const auto& ray, const InstanceLike auto& instance) {
        tell_instance(ray, instance, outcome_masked);
    }

private:
    void tell_instance(const RayView& ray, const InstanceLike auto& instance,
                       StepOutcome outcome) const {
        Step step = step_of(step_instance, ray);
        step.outcome = outcome;
        step.place = instance.index;
        watch.tell(step);
    }
    static std::uint32_t place_of(const RayView& ray, const Triangles8& triangles) {
        return static_cast<std::uint32_t>(triangles.block - ray.scene->blocks -
                                          ray.object->first_block);
    }
    template <class P>
    static std::uint32_t place_of(const RayView& ray, const Record<P>& record) {
        const auto* at = reinterpret_cast<const std::byte*>(record.value);
        const auto offset = at - ray.scene->records - ray.object->first_record;
        return static_cast<std::uint32_t>(offset / (sizeof(P) + sizeof(std::uint32_t)));
    }
};

/// The nearest hit, and what became of each candidate that reached it.
struct ObservedClosest : ClosestHit {
    Watch* watch = nullptr;

    template <class R, class P, int N>
    bool take(R& ray, const Hits<P, N>& hits) {
        if (watch->observer.candidates == 0) return ClosestHit::take(ray, hits);
        tell_candidates(*watch, ray, hits, watch->survivors & ~hits.mask, outcome_culled, no_words);
        for_each_record(ray, hits, [&](int lane, const HitRecord& record) {
            const StepOutcome outcome = record.before(best) ? outcome_accepted : outcome_behind;
            tell_candidates(*watch, ray, hits, 1U << lane, outcome, no_words);
            add(record, ray.tmax);
        });
        return false;
    }
};

struct ObservedIO : TraceIO<query_closest> {
    Watch& watch;

    [[nodiscard]] bool begin(std::uint32_t i, RayView& view) const {
        if (TraceIO::begin(i, view)) return true;
        tell_end(i);
        return false;
    }
    [[nodiscard]] ObservedClosest query_in_place(std::uint32_t i) const {
        return {TraceIO::query(i), &watch};
    }
    void end(std::uint32_t i, const ObservedClosest& query) const {
        TraceIO::end(i, query);
        tell_end(i);
    }

private:
    void tell_end(std::uint32_t i) const {
        watch.observer.end(watch.observer.context, first + i, call.hits + first + i);
    }
};

}  // namespace raynest
