#include "engine/scene/motion/affine.h"

#include <cmath>
#include <cstddef>

namespace raynest {

Affine from_trs(const double* t, const double* r, const double* s) {
    const double n = 1 / std::sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2] + r[3] * r[3]);
    const double x = r[0] * n;
    const double y = r[1] * n;
    const double z = r[2] * n;
    const double w = r[3] * n;
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

Transform round_affine(const Affine& affine) {
    Transform transform;
    for (std::size_t i = 0; i < 12; ++i) transform.m[i] = static_cast<float>(affine[i]);
    return transform;
}

}  // namespace raynest
