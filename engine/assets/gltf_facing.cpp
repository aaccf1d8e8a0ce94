#include "engine/assets/gltf_facing.h"

#include "engine/assets/gltf_names.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstddef>

namespace raynest::gltf {
namespace {

/// Leaves of trees and hair often have normals of the shape around them: some of those point behind
/// a face on purpose.
constexpr std::uint64_t most_per_hundred = 25;

}  // namespace

void Facing::count(const GeometryDescription& geometry) {
    if (geometry.normals.empty()) return;
    triangles_ += geometry.indices.size() / 3;
    for (std::size_t i = 0; i < geometry.indices.size(); i += 3) {
        const std::uint32_t* const corner = geometry.indices.data() + i;
        const glm::dvec3 p(geometry.positions[corner[0]]);
        const glm::dvec3 face = glm::cross(glm::dvec3(geometry.positions[corner[1]]) - p,
                                           glm::dvec3(geometry.positions[corner[2]]) - p);
        const bool against = std::all_of(corner, corner + 3, [&](std::uint32_t vertex) {
            return glm::dot(face, glm::dvec3(geometry.normals[vertex])) < 0;
        });
        against_ += against ? 1U : 0U;
    }
}

void Facing::end_mesh(const std::string& where) {
    if (100 * against_ > most_per_hundred * triangles_) {
        if (first_.empty())
            first_ = fmt::format("{}: the NORMALs of {} of its {} point against the faces", where,
                                 against_, counted(triangles_, "triangle", "triangles"));
        others_.insert(where);
    }
    triangles_ = against_ = 0;
}

std::string Facing::warning() const {
    if (first_.empty()) return {};
    const std::size_t others = others_.size() - 1;
    return fmt::format("{}{}. Lit pictures show such faces too dark: turn the normals or the "
                       "faces in the program that wrote the file",
                       first_,
                       others == 0 ? ""
                                   : fmt::format(", and so do many of {}",
                                                 counted(others, "other mesh", "other meshes")));
}

}  // namespace raynest::gltf
