#include "engine/assets/formats/file_content.h"

namespace raynest {
namespace {

using CornerPlaces = std::vector<std::uint32_t>;

double area_of(const glm::dvec2& a, const glm::dvec2& b, const glm::dvec2& c) {
    return (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
}

/// Projects a polygon along the axis in which it faces most, so that it turns to the left.
std::vector<glm::dvec2> flatten(const std::vector<glm::dvec3>& positions,
                                const CornerPlaces& corners) {
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

/// Cuts ears off a polygon that turns to the left: corners that turn to the left, with no other
/// corner in their triangle.
class EarCutter {
public:
    explicit EarCutter(const std::vector<glm::dvec2>& flat)
        : flat_(flat),
          before_(flat.size()),
          after_(flat.size()) {
        const auto count = static_cast<std::uint32_t>(flat.size());
        for (std::uint32_t i = 0; i < count; ++i) {
            before_[i] = (i + count - 1) % count;
            after_[i] = (i + 1) % count;
        }
    }

    /// Appends the triangles of the ears to `out`, and returns what remains: three corners, or more
    /// where the polygon crosses itself or has no area.
    CornerPlaces cut(CornerPlaces& out) {
        std::size_t left = flat_.size();
        std::uint32_t at = 0;
        for (std::size_t tried = 0; left > 3 && tried < left;) {
            if (!is_ear(at)) {
                at = after_[at];
                ++tried;
                continue;
            }
            out.insert(out.end(), {before_[at], at, after_[at]});
            after_[before_[at]] = after_[at];
            before_[after_[at]] = before_[at];
            --left;
            at = before_[at];
            tried = 0;
        }
        CornerPlaces rest;
        for (; left > 0; --left, at = after_[at]) rest.push_back(at);
        return rest;
    }

private:
    [[nodiscard]] bool is_ear(std::uint32_t at) const {
        const glm::dvec2 a = flat_[before_[at]], b = flat_[at], c = flat_[after_[at]];
        if (!(area_of(a, b, c) > 0)) return false;
        for (std::uint32_t other = after_[after_[at]]; other != before_[at];
             other = after_[other]) {
            const glm::dvec2 p = flat_[other];
            if (p == a || p == b || p == c) continue;
            if (area_of(a, b, p) >= 0 && area_of(b, c, p) >= 0 && area_of(c, a, p) >= 0)
                return false;
        }
        return true;
    }

    const std::vector<glm::dvec2>& flat_;
    CornerPlaces before_, after_;  ///< the corners that remain
};

}  // namespace

void triangulate(const std::vector<glm::dvec3>& positions, const CornerPlaces& corners,
                 CornerPlaces& out) {
    constexpr std::size_t ears_max = 10'000;
    const std::size_t count = corners.size();
    const auto fan = [&](const CornerPlaces& rest) {
        for (std::uint32_t i = 1; i + 1 < rest.size(); ++i)
            out.insert(out.end(), {rest[0], rest[i], rest[i + 1]});
    };
    if (count > 3 && count <= ears_max) {
        const std::vector<glm::dvec2> flat = flatten(positions, corners);
        if (!is_convex(flat)) return fan(EarCutter(flat).cut(out));
    }
    CornerPlaces all(count);
    for (std::uint32_t i = 0; i < count; ++i) all[i] = i;
    fan(all);
}

}  // namespace raynest
