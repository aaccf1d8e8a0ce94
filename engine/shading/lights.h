// The list lights.def as code: a switch over the kinds, made at compile time.
#pragma once

#include "engine/shading/light.h"
#include "shading_headers.h"  // the header of each row, made by CMake

namespace raynest {

#define RAYNEST_LIGHT(name, Type) \
    static_assert(LightLike<Type>, "a light of lights.def lacks a member, see light.h");
#include "engine/shading/lights.def"

/// Calls f(light) with the light of a kind; one that this build lacks shines as a point.
template <class F>
auto with_light(std::uint32_t kind, F&& f) {
    switch (kind) {
#define RAYNEST_LIGHT(name, Type) \
    case shading_type(#name):     \
        return f(Type{});
#include "engine/shading/lights.def"
        default:
            return f(PointLight{});
    }
}

}  // namespace raynest
