#include "engine/assets/gltf/facing.h"

#include "engine/assets/input/messages.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>

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
        // A triangle without a surface has no normal to lose.
        if (face == glm::dvec3(0)) continue;
        const bool nowhere = std::any_of(corner, corner + 3, [&](std::uint32_t vertex) {
            const glm::dvec3 normal(geometry.normals[vertex]);
            return !(glm::dot(normal, normal) > 0) || !std::isfinite(glm::dot(normal, normal));
        });
        nowhere_ += nowhere ? 1U : 0U;
    }
}

void Facing::end_mesh(const std::string& where) {
    const auto note = [&](Faulty& faulty, std::uint64_t count, const char* fault) {
        if (faulty.first.empty())
            faulty.first = fmt::format("{}: the NORMALs of {} of its {} {}", where, count,
                                       counted(triangles_, "triangle", "triangles"), fault);
        faulty.names.insert(where);
    };
    if (100 * against_ > most_per_hundred * triangles_)
        note(turned_, against_, "point against the faces");
    if (nowhere_ != 0) note(directionless_, nowhere_, "are 0 or not finite");
    triangles_ = against_ = nowhere_ = 0;
}

std::string Facing::Faulty::line(const char* others_do, const char* effect) const {
    if (first.empty()) return {};
    const std::size_t others = names.size() - 1;
    return first +
           (others == 0 ? std::string()
                        : fmt::format(", and so {} of {}", others_do,
                                      counted(others, "other mesh", "other meshes"))) +
           effect;
}

std::vector<std::string> Facing::warnings() const {
    std::vector<std::string> lines;
    for (std::string line :
         {turned_.line("do many",
                       ". Lit pictures show such faces too dark: turn the normals or the faces in "
                       "the program that wrote the file"),
          directionless_.line("are some", "; such faces are shown flat")})
        if (!line.empty()) lines.push_back(std::move(line));
    return lines;
}

}  // namespace raynest::gltf
