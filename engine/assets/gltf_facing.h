// Finds meshes whose normals point against their faces: an export that turned one of the two.
#pragma once

#include "engine/scene/description.h"

#include <cstdint>
#include <set>
#include <string>

namespace raynest::gltf {

/// Compares the normals of meshes, one mesh after the other, with the winding of their triangles.
class Facing {
public:
    /// Counts the triangles of a geometry of the mesh that is being read, and those of which all
    /// three normals point behind the face.
    void count(const GeometryDescription& geometry);

    /// Ends a mesh, which the warning names as `where`.
    void end_mesh(const std::string& where);

    /// Returns one line about all meshes of which more than a quarter points the wrong way; ""
    /// where there is none.
    [[nodiscard]] std::string warning() const;

private:
    std::uint64_t triangles_ = 0, against_ = 0;  ///< of the mesh that is being read
    std::string first_;                          ///< the first such mesh, and its counts
    std::set<std::string> others_;
};

}  // namespace raynest::gltf
