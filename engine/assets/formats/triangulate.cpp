#include "engine/assets/formats/content.h"

namespace raynest {
namespace {

using Places = std::vector<std::uint32_t>;

double area_of(const glm::dvec2& a, const glm::dvec2& b, const glm::dvec2& c) {
    return (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
}

/// Projects a polygon along the axis in which it faces most, so that it turns to the left.
std::vector<glm::dvec2> flatten(const std::vector<glm::dvec3>& positions, const Places& corners) {
    glm::dvec3 normal(0);  // Newell's: exact for flat polygons, sensible for others
    for (std::size_t i = 0; i < corners.size(); ++i) {
        const glm::dvec3 from = positions[corners[i]] - positions[corners[0]];
        const glm::dvec3 to = positions[corners[(i + 1) % corners.size()]] - positions[corners[0]];
        normal += glm::cross(from, to);
    }
    const glm::dvec3 size = glm::abs(normal);
    const int axis = size.x > size.y ? (size.x > size.z ? 0 : 2) : (size.y > size.z ? 1 : 2);
    const int u = (axis + 1) % 3;
    const int v = (axis + 2) % 3;
    std::vector<glm::dvec2> flat;
    flat.reserve(corners.size());
    for (const std::uint32_t corner : corners) {
        const glm::dvec3 p = positions[corner] - positions[corners[0]];
        flat.push_back(normal[axis] < 0 ? glm::dvec2(p[v], p[u]) : glm::dvec2(p[u], p[v]));
    }
    return flat;
}

bool is_convex(const std::vector<glm::dvec2>& flat) {
    const std::size_t count = flat.size();
    for (std::size_t i = 0; i < count; ++i) {
        if (area_of(flat[i], flat[(i + 1) % count], flat[(i + 2) % count]) < 0) return false;
    }
    return true;
}

/// True if the corner at `at` of the remaining ones can be cut off: it turns to the left, and no
/// other corner lies in its triangle.
bool is_ear(const std::vector<glm::dvec2>& flat, const Places& rest, std::size_t at) {
    const std::uint32_t before = rest[(at + rest.size() - 1) % rest.size()];
    const std::uint32_t after = rest[(at + 1) % rest.size()];
    const glm::dvec2 a = flat[before];
    const glm::dvec2 b = flat[rest[at]];
    const glm::dvec2 c = flat[after];
    if (!(area_of(a, b, c) > 0)) return false;
    for (const std::uint32_t other : rest) {
        const glm::dvec2 p = flat[other];
        if (p == a || p == b || p == c) continue;
        if (area_of(a, b, p) >= 0 && area_of(b, c, p) >= 0 && area_of(c, a, p) >= 0) return false;
    }
    return true;
}

}  // namespace

void triangulate(const std::vector<glm::dvec3>& positions, const Places& corners, Places& out) {
    constexpr std::size_t ears_max = 1000;
    const std::size_t count = corners.size();
    const auto fan = [&](const Places& rest) {
        for (std::uint32_t i = 1; i + 1 < rest.size(); ++i)
            out.insert(out.end(), {rest[0], rest[i], rest[i + 1]});
    };
    Places rest(count);
    for (std::uint32_t i = 0; i < count; ++i) rest[i] = i;
    if (count == 3 || count > ears_max) return fan(rest);
    const std::vector<glm::dvec2> flat = flatten(positions, corners);
    if (is_convex(flat)) return fan(rest);
    while (rest.size() > 3) {
        std::size_t at = 0;
        while (at < rest.size() && !is_ear(flat, rest, at)) ++at;
        if (at == rest.size()) break;  // it crosses itself or has no area
        out.insert(out.end(), {rest[(at + rest.size() - 1) % rest.size()], rest[at],
                               rest[(at + 1) % rest.size()]});
        rest.erase(rest.begin() + static_cast<std::ptrdiff_t>(at));
    }
    fan(rest);
}

}  // namespace raynest
