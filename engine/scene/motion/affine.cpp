#include "engine/scene/motion/affine.h"

#include <algorithm>
#include <cmath>
#include <cstddef>

namespace raynest {

Affine from_trs(const double* t, const double* r, const double* s) {
    // Squares of very long and very short quaternions leave the range of doubles.
    const double most = std::max({std::abs(r[0]), std::abs(r[1]), std::abs(r[2]), std::abs(r[3])});
    const double by = most > 1e100 || most < 1e-100 ? 1 / most : 1;
    const double a = r[0] * by, b = r[1] * by, c = r[2] * by, d = r[3] * by;
    const double n = 1 / std::sqrt(a * a + b * b + c * c + d * d);
    const double x = a * n;
    const double y = b * n;
    const double z = c * n;
    const double w = d * n;
    return {(1 - 2 * (y * y + z * z)) * s[0], 2 * (x * y - z * w) * s[1],
            2 * (x * z + y * w) * s[2],       t[0],
            2 * (x * y + z * w) * s[0],       (1 - 2 * (x * x + z * z)) * s[1],
            2 * (y * z - x * w) * s[2],       t[1],
            2 * (x * z - y * w) * s[0],       2 * (y * z + x * w) * s[1],
            (1 - 2 * (x * x + y * y)) * s[2], t[2]};
}

Affine multiply(const Affine& a, const Affine& b) {
    Affine out{};
    for (std::size_t row = 0; row < 12; row += 4) {
        for (std::size_t column = 0; column < 4; ++column) {
            out[row + column] = a[row] * b[column] + a[row + 1] * b[4 + column] +
                                a[row + 2] * b[8 + column] + (column == 3 ? a[row + 3] : 0.0);
        }
    }
    return out;
}

std::optional<Affine> invert(const Affine& map) {
    const auto column = [&](std::size_t c) { return glm::dvec3(map[c], map[4 + c], map[8 + c]); };
    const glm::dvec3 x = column(0), y = column(1), z = column(2);
    const double volume = glm::dot(glm::cross(x, y), z);
    if (volume == 0 || !std::isfinite(volume)) return std::nullopt;
    const std::array<glm::dvec3, 3> rows{glm::cross(y, z) / volume, glm::cross(z, x) / volume,
                                         glm::cross(x, y) / volume};
    Affine inverse;
    for (std::size_t r = 0; r < 3; ++r) {
        for (std::size_t c = 0; c < 3; ++c) inverse[4 * r + c] = rows[r][static_cast<int>(c)];
        inverse[4 * r + 3] = -glm::dot(rows[r], column(3));
    }
    return inverse;
}

std::optional<Affine> change_of(const Affine& before, const Transform& now) {
    bool is_same = true;
    for (std::size_t row = 0; row < 12; row += 4) {
        double most = 0;
        for (std::size_t c = 0; c < 4; ++c) most = std::max(most, std::abs(before[row + c]));
        for (std::size_t i = row; i < row + 4; ++i) {
            const double room = 0x1p-23 * std::abs(before[i]) + 1e-12 * most;
            is_same = is_same && std::abs(static_cast<double>(now.m[i]) - before[i]) <= room;
        }
    }
    if (is_same) return std::nullopt;
    const auto back = invert(before);
    if (!back) return std::nullopt;
    return multiply(affine_of(now), *back);
}

Transform round_affine(const Affine& affine) {
    Transform transform;
    for (std::size_t i = 0; i < 12; ++i) transform.m[i] = static_cast<float>(affine[i]);
    return transform;
}

}  // namespace raynest
