// What a line of intersectors/LIST declares, and what a type is asked for to see whether it is so.
#pragma once

#include "engine/bvh/ask.h"
#include "engine/geometry/record_types.h"

#include <type_traits>
#include <utility>

namespace raynest {

/// What a line of the list says that the intersector overrides.
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
