// The list LIGHTS as code: a switch over the kinds, made at compile time.
#pragma once

#include "engine/shading/light.h"
#include "shading_types.h"  // the list's headers and RAYNEST_FOR_EACH_LIGHT, made by CMake

namespace raynest {

#define RAYNEST_CHECK(name, Type) \
    static_assert(LightLike<Type>, "a light of LIGHTS lacks a member, see light.h");
RAYNEST_FOR_EACH_LIGHT(RAYNEST_CHECK)
#undef RAYNEST_CHECK

/// Calls f(light) with the light of a kind; one that this build lacks shines as a point.
template <class F>
auto with_light(std::uint32_t kind, F&& f) {
    switch (kind) {
#define RAYNEST_CASE(name, Type) \
    case shading_type(#name):    \
        return f(Type{});
        RAYNEST_FOR_EACH_LIGHT(RAYNEST_CASE)
#undef RAYNEST_CASE
        default:
            return f(PointLight{});
    }
}

}  // namespace raynest
