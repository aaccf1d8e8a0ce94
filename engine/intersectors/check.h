// Turns mistakes that would silently disable an intersector into one readable compile error.
//
// An overload that takes only one ray width, is private, returns the wrong type or names the wrong
// concept would not be called, perhaps in one kernel only: its mask would be ignored.
// packs/variant.cpp has one static_assert(check_intersector<...>()) per row of intersectors.def.
#pragma once

#include "engine/bvh/box_test.h"
#include "engine/bvh/intersect_with.h"
#include "engine/bvh/visit.h"
#include "engine/intersectors/counting.h"
#include "engine/intersectors/declared.h"
#include "engine/intersectors/each_once.h"

namespace raynest {

template <class Isect>
inline constexpr bool overrides_a_triangle = Overrides<Isect, RayView, TriangleRef>;
template <class Isect>
inline constexpr bool overrides_a_block = Overrides<Isect, BoxRay, Triangles8>;
template <class Isect>
inline constexpr bool overrides_a_box = Overrides<Isect, RayView, BoxRef>;
template <class Isect>
inline constexpr bool overrides_a_node = Overrides<Isect, BoxRay, Boxes8>;

template <class Isect>
constexpr bool keeps_outputs_where_they_are_read() {
    if constexpr (has_outputs<Isect>) {
        return requires(Isect & isect, typename Isect::Outputs * state) {
            isect.state = state;
        };
    } else {
        return !requires(Isect & isect) {
            isect.state;
            typename Isect::Outputs;
        };
    }
}

template <class Isect, Declared declared>
constexpr bool check_intersector() {
    static_assert(overrides_a_triangle<Isect> == overrides_a_block<Isect>,
                  "the triangle overload takes one width only; write "
                  "auto operator()(const auto& ray, const TriangleLike auto& triangle)");
    static_assert(overrides_a_box<Isect> == overrides_a_node<Isect>,
                  "the box overload takes one width only; write "
                  "auto operator()(const auto& ray, const BoxLike auto& boxes)");
    static_assert(returns_what_intersect_returns<Isect, BoxRay, Triangles8>() &&
                      returns_what_intersect_returns<Isect, RayView, TriangleRef>() &&
                      returns_what_intersect_returns<Isect, BoxRay, Boxes8>() &&
                      returns_what_intersect_returns<Isect, RayView, BoxRef>(),
                  "an overload must return what intersect(ray, thing) returns");
    static_assert(
        (overrides_a_block<Isect> || overrides_any_record<Isect>()) == declared.primitives,
        "the row and the type disagree about `primitives`: is operator() public, "
        "not const-qualified away, and constrained by TriangleLike or PrimitiveLike?");
    static_assert(overrides_a_node<Isect> == declared.boxes,
                  "the row and the type disagree about `boxes`: is operator() public and "
                  "constrained by BoxLike?");
    static_assert(Overrides<Isect, BoxRay, Instance> == declared.instances,
                  "the row and the type disagree about `instances`: is operator() public "
                  "and constrained by InstanceLike?");
    static_assert(
        keeps_outputs_where_they_are_read<Isect>(),
        "an intersector with `outputs` has `Outputs* state = nullptr;`, which it writes, and "
        "one with `state` has `outputs`, which name its members");
    static_assert(
        !has_outputs<Isect> || !overrides_a_block<Isect> ||
            (Overrides<Isect, BoxRay, Once<Triangles8>> && !NamesTriangles8<Isect, BoxRay>),
        "an intersector with `outputs` sees each triangle once; write "
        "auto operator()(const auto& ray, const TriangleLike auto& triangle)");
    return true;
}

}  // namespace raynest
