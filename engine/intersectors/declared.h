// The overrides that a row of intersectors.def declares, and the tests that compare them with the
// type.
#pragma once

#include "engine/bvh/intersect_with.h"
#include "engine/geometry/record_types.h"

#include <type_traits>
#include <utility>

namespace raynest {

/// The overrides that a row of the list declares.
struct Declared {
    bool boxes = false;
    bool primitives = false;
    bool instances = false;
};

template <class Isect, class R, class P>
constexpr bool returns_what_intersect_returns() {
    if constexpr (Overrides<Isect, R, P>) {
        using Plain = decltype(intersect(std::declval<const R&>(), std::declval<const P&>()));
        using Own =
            decltype(std::declval<Isect&>()(std::declval<const R&>(), std::declval<const P&>()));
        return std::is_same_v<Plain, Own>;
    } else {
        return true;
    }
}

template <class Isect>
constexpr bool overrides_any_record() {
    bool any = false;
    for_each_record_type(
        [&]<class P>(RecordType<P>) { any = any || Overrides<Isect, RayView, Record<P>>; });
    return any;
}

}  // namespace raynest
