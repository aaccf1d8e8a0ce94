// The list materials.def as code: a switch over the kinds, made at compile time.
#pragma once

#include "engine/shading/material.h"
#include "engine/shading/records.h"
#include "shading_headers.h"  // the header of each row, made by CMake

namespace raynest {

#define RAYNEST_MATERIAL(name, Type)                                 \
    static_assert(MaterialLike<Type>,                                \
                  "a material of materials.def lacks a member, see " \
                  "material.h");
#include "engine/shading/materials.def"

/// Calls f(material) with the material of a kind; one that this build lacks is glTF's.
template <class F>
auto with_material(std::uint32_t kind, const MaterialPoint& point, const Vec3& outgoing, F&& f) {
    switch (kind) {
#define RAYNEST_MATERIAL(name, Type) \
    case shading_type(#name):        \
        return f(Type(point, outgoing));
#include "engine/shading/materials.def"
        default:
            return f(Standard(point, outgoing));
    }
}

}  // namespace raynest
