// The contents of a file as a reader of this folder gives them, before they are placed in the
// world.
#pragma once

#include "engine/assets/input/import_request.h"
#include "engine/math/vec.h"
#include "engine/result.h"
#include "engine/scene/description.h"

#include <cstdint>
#include <string>
#include <vector>

namespace raynest {

/// Triangles with one material, in the file's unit. `rest.positions` stays empty.
struct FileGeometry {
    std::vector<glm::dvec3> positions;
    GeometryDescription rest;
};

/// Named geometries; the name becomes the path of a placement.
struct FileObject {
    std::string name;
    std::vector<FileGeometry> geometries;
};

/// The contents of a file. Either objects or points.
struct FileContent {
    std::vector<FileObject> objects;
    std::vector<glm::dvec3> points;                ///< centres of spheres
    std::vector<double> radii;                     ///< empty or one per point
    std::vector<std::uint8_t> point_colours = {};  ///< empty or RGBA per point, sRGB
    /// True if the file has float32 coordinates, which may have lost digits before they came here.
    bool is_float32 = false;
    /// True if coordinates are those of a map: an origin is chosen unless the request has one.
    bool is_surveyed = false;
    std::vector<MaterialDescription> materials;
    std::vector<TextureDescription> textures;
    std::vector<ImageDescription> images;
    std::vector<std::string> warnings;
};

/// Applies `request.options` and the origin to the content, in double, and rounds it to float32.
/// One object becomes the scene's root; several become placements under it, by name. Points become
/// records of type "sphere"; those that are not finite are left out.
///
/// scene_invalid: nothing to hit, a vertex that is not finite or lies beyond 1e15, or a point
/// without a radius. limit_exceeded: over triangles_max triangles or points, or nodes_max objects.
Result<SceneDescription> place(FileContent content, const ImportRequest& request,
                               const ImportLimits& limits);

/// Appends the triangles of a polygon of three or more corners: a fan where it is convex, else by
/// cutting ears. A polygon of over 10,000 corners is a fan in any case, so that its time stays
/// below some seconds. `corners` are numbers of `positions`, `out` gets places in `corners`.
void triangulate(const std::vector<glm::dvec3>& positions,
                 const std::vector<std::uint32_t>& corners, std::vector<std::uint32_t>& out);

}  // namespace raynest
