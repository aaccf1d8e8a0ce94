// The answer of a query per ray, before it is written as columns.
#pragma once

#include "engine/math/vec.h"

#include <cstdint>
#include <limits>

namespace raynest {

inline constexpr std::uint32_t no_id = 0xFFFFFFFFU;
inline constexpr std::uint64_t no_path = 0xFFFFFFFFFFFFFFFFULL;

enum HitFlags : std::uint8_t {
    hit_invalid_ray = 1,
    hit_truncated = 2,
    hit_given_up = 128  ///< a GPU left the ray to the CPU; no client sees this flag
};

/// 32 bytes at any nesting depth. `triangle` is the index among all primitives of the object in
/// declaration order (the geometries' triangles one after the other, or the index of a record);
/// queries/columns.h turns it into `geom` and `prim`. A default-constructed record is the canonical
/// miss.
struct HitRecord {
    float t = std::numeric_limits<float>::infinity();
    float u = 0;
    float v = 0;
    std::uint32_t triangle = no_id;
    std::uint64_t path = no_path;
    std::uint32_t object = no_id;
    std::uint8_t k = 0;      ///< which of the primitive's own hits: a sphere has two
    std::uint8_t front = 0;  ///< 1: the ray met the side that the normal points to
    std::uint8_t flags = 0;  ///< HitFlags
    std::uint8_t hit = 0;

    /// The total order of hits: (t, path, geom, prim, k); the flat index orders
    /// (geom, prim).
    [[nodiscard]] RAYNEST_FN bool before(const HitRecord& other) const {
        if (t != other.t) return t < other.t;
        if (path != other.path) return path < other.path;
        if (triangle != other.triangle) return triangle < other.triangle;
        return k < other.k;
    }
};
static_assert(sizeof(HitRecord) == 32);

/// The sums of the Counting adapter.
struct Counters {
#define RAYNEST_COUNTER(name, title) std::uint32_t name = 0;
#define RAYNEST_SUM(name, value, title)
#include "engine/geometry/counters.def"
};

}  // namespace raynest
