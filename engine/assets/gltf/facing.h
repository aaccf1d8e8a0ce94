// Finds meshes whose normals point against their faces, or nowhere: an export that went wrong.
#pragma once

#include "engine/scene/description.h"

#include <cstdint>
#include <set>
#include <string>
#include <vector>

namespace raynest::gltf {

/// Compares the normals of meshes, one mesh after the other, with the winding of their triangles.
class Facing {
public:
    /// Counts the triangles of a geometry of the mesh that is being read, those of which all three
    /// normals point behind the face, and those of which one is 0 or not finite.
    void count(const GeometryDescription& geometry);

    /// Ends a mesh, which the warning names as `where`.
    void end_mesh(const std::string& where);

    /// Returns one line about all meshes of which more than a quarter points the wrong way, and one
    /// about all that have normals without a direction.
    [[nodiscard]] std::vector<std::string> warnings() const;

private:
    /// Meshes with one fault.
    struct Faulty {
        std::string first;  ///< the first of them, and its counts
        std::set<std::string> names;
        /// Returns "" if there is none.
        [[nodiscard]] std::string line(const char* others_do, const char* effect) const;
    };
    std::uint64_t triangles_ = 0, against_ = 0, nowhere_ = 0;  ///< in the mesh that is being read
    Faulty turned_, directionless_;
};

}  // namespace raynest::gltf
