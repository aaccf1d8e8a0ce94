// The list MATERIALS as code: a switch over the kinds, made at compile time.
#pragma once

#include "engine/shading/material.h"
#include "engine/shading/records.h"
#include "shading_types.h"  // the list's headers and RAYNEST_FOR_EACH_MATERIAL, made by CMake

namespace raynest {

#define RAYNEST_CHECK(name, Type) \
    static_assert(MaterialLike<Type>, "a material of MATERIALS lacks a member, see material.h");
RAYNEST_FOR_EACH_MATERIAL(RAYNEST_CHECK)
#undef RAYNEST_CHECK

/// Calls f(material) with the material of a kind; one that this build lacks is glTF's.
template <class F>
auto with_material(std::uint32_t kind, const MaterialPoint& point, const Vec3& outgoing, F&& f) {
    switch (kind) {
#define RAYNEST_CASE(name, Type) \
    case shading_type(#name):    \
        return f(Type(point, outgoing));
        RAYNEST_FOR_EACH_MATERIAL(RAYNEST_CASE)
#undef RAYNEST_CASE
        default:
            return f(Standard(point, outgoing));
    }
}

}  // namespace raynest
