// Meshes whose vertices move: the same triangles with other corners.
#pragma once

#include "engine/geometry/box.h"
#include "engine/math/vec.h"
#include "engine/scene/edits/edited_arena.h"

#include <cstdint>
#include <span>

namespace raynest {

/// Returns how many vertices an object has: those of its geometries, one behind the other.
std::uint64_t vertex_count(const SceneView& view, const ObjectRecord& object);

/// Vertices of an object in its space, those of its geometries one behind the other.
struct NewVertices {
    std::span<const Vec3> positions;
    std::span<const Vec3> normals = {};   ///< empty: made from the triangles around them
    std::span<const Vec4> tangents = {};  ///< empty: they stay
};

/// Moves the vertices of an object: in its attributes and in the leaf blocks of its tree. Normals
/// and tangents change where geometries have them. Does not refit the tree. The positions are
/// vertex_count() finite points, normals and tangents none or as many. Returns by how much the
/// number of degenerate triangles has grown.
std::int64_t deform(EditedArena& arena, const ObjectRecord& object, NewVertices vertices);

/// Returns the box of a leaf of triangles.
Box box_of_leaf(const SceneView& view, const ObjectRecord& object, std::uint32_t leaf);

}  // namespace raynest
