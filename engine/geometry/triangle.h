// Triangles: one by itself, and blocks of eight as the tree's leaves hold them.
#pragma once

#include "engine/geometry/box.h"
#include "engine/geometry/hit.h"
#include "engine/math/vec.h"

#include <cstdint>

namespace raynest {

/// A triangle in a plain list. `prim` and `geom` are the caller's own ids.
struct Triangle {
    using triangle_tag = void;  ///< TriangleLike (geometry/concepts.h)
    Vec3 v0, v1, v2;
    std::uint32_t prim = 0;
    std::uint32_t geom = 0;
};

/// Eight triangles, structure of arrays: vertex[corner][axis][lane]. Vertices, not edges, so that
/// neighbours share the exact same bits (watertight tests need that). Padding lanes have id no_id
/// and three equal vertices at the origin: their determinant is 0, they can never be hit.
struct alignas(64) TriangleBlock {
    float vertex[3][3][8];
    std::uint32_t triangle[8];
};
static_assert(sizeof(TriangleBlock) == 320);

[[nodiscard]] inline Box bounds(const Triangle& t) {
    Box box;
    box.extend(t.v0);
    box.extend(t.v1);
    box.extend(t.v2);
    return box;
}

}  // namespace raynest
