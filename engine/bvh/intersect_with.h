// The only way between kernels and intersectors: intersect_with(intersector, ray, thing).
//
// An intersector is any type with call operators; what it does not overload is plain intersect().
// There is no base class to derive from (the paper's basic_intersector): traversal recurses
// instead, so adapters compose by holding a member, and the four silent traps of inheriting a
// default overload (hidden, const, by value, one width only) either work or fail to compile
// (intersectors/check.h).
#pragma once

#include "engine/geometry/concepts.h"
#include "engine/math/lanes.h"

namespace raynest {

template <class Isect, class R, class P>
concept Overrides = requires(Isect& isect, const R& ray, const P& thing) {
    isect(ray, thing);
};

/// The intersector's answer where it has one, else intersect(ray, thing). With RAYNEST_NO_HOOKS
/// every call is plain intersect(): the control of the test that an unused hook costs no
/// instruction.
template <class Isect, class R, class P>
RAYNEST_INLINE auto intersect_with([[maybe_unused]] Isect& isect, const R& ray, const P& thing) {
#ifndef RAYNEST_NO_HOOKS
    if constexpr (Overrides<Isect, R, P>) {
        return isect(ray, thing);
    } else
#endif
    {
        return intersect(ray, thing);
    }
}

/// May the ray enter this instance? An intersector may overload `bool operator()(const auto& ray,
/// const InstanceLike auto&)`: masks, levels of detail, counting. Yes where it does not.
template <class Isect, class R, InstanceLike T>
RAYNEST_INLINE bool enters([[maybe_unused]] Isect& isect, [[maybe_unused]] const R& ray,
                           [[maybe_unused]] const T& instance) {
#ifndef RAYNEST_NO_HOOKS
    if constexpr (Overrides<Isect, R, T>) return isect(ray, instance);
#endif
    return true;
}

}  // namespace raynest
