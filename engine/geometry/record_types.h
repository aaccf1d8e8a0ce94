// The primitive types that this translation unit knows beside triangles.
//
// A pack's list comes from geometry/primitives.def through CMake (packs/pack.cmake), which defines
// RAYNEST_RECORD_TYPES as a header with the types' headers and a macro of all rows; code that is
// compiled without it knows the built-in sphere.
#pragma once

#include "engine/geometry/record.h"
#include "engine/geometry/views.h"

#include <cstdint>

#ifdef RAYNEST_RECORD_TYPES
#include RAYNEST_RECORD_TYPES
#else
#include "engine/geometry/sphere.h"
#define RAYNEST_FOR_EACH_RECORD_TYPE(X) X(sphere, Sphere)
#endif

namespace raynest {

template <class P>
struct RecordType {
    using type = P;
    const char* name;
    std::uint32_t id;
};

/// Calls `f(RecordType<P>)` for every type.
template <class F>
constexpr void for_each_record_type(F&& f) {
#define RAYNEST_CALL(name, Type)                                                                \
    static_assert(RecordPrimitive<Type>,                                                        \
                  #Type " needs Box bounds(const " #Type                                        \
                        "&) and intersect(const auto& ray, "                                    \
                        "const " #Type                                                          \
                        "&) that returns RecordHits, and must be trivially copyable, of whole " \
                        "4-byte words, and aligned to 4 bytes at most");                        \
    f(RecordType<Type>{#name, primitive_type(#name)});
    RAYNEST_FOR_EACH_RECORD_TYPE(RAYNEST_CALL)
#undef RAYNEST_CALL
}

}  // namespace raynest
