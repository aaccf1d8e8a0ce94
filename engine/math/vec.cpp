#include "engine/math/vec.h"

#include <cstddef>
#include <limits>

namespace raynest {
namespace {

/// Returns element (row, column) of the 3x3 part, in double.
double at(const Transform& t, std::size_t row, std::size_t column) {
    return static_cast<double>(t.m[4 * row + column]);
}

double translation(const Transform& t, std::size_t row) {
    return at(t, row, 3);
}

/// Returns `rows` rows of a matrix of twelve elements, column by column.
std::array<float, 12> transposed(const std::array<float, 12>& m, std::size_t rows) {
    const std::size_t columns = m.size() / rows;
    std::array<float, 12> result;
    for (std::size_t row = 0; row < rows; ++row) {
        for (std::size_t column = 0; column < columns; ++column) {
            result[rows * column + row] = m[columns * row + column];
        }
    }
    return result;
}

}  // namespace

ColumnTransform by_columns(const Transform& transform) {
    return {transposed(transform.m, 3)};
}

Transform by_rows(const ColumnTransform& transform) {
    return {transposed(transform.m, 4)};
}

Transform compose(const Transform& outer, const Transform& inner) {
    Transform result;
    for (std::size_t row = 0; row < 3; ++row) {
        for (std::size_t column = 0; column < 4; ++column) {
            double sum = column == 3 ? translation(outer, row) : 0.0;
            for (std::size_t k = 0; k < 3; ++k) sum += at(outer, row, k) * at(inner, k, column);
            result.m[4 * row + column] = static_cast<float>(sum);
        }
    }
    return result;
}

bool invert(const Transform& transform, Transform& inverse) {
    inverse.m.fill(0);

    // Cofactors: entry (c, r) of the adjugate is the signed minor without row r and column c.
    double adjugate[3][3];
    for (std::size_t r = 0; r < 3; ++r) {
        for (std::size_t c = 0; c < 3; ++c) {
            const std::size_t r1 = (r + 1) % 3, r2 = (r + 2) % 3;
            const std::size_t c1 = (c + 1) % 3, c2 = (c + 2) % 3;
            adjugate[c][r] = at(transform, r1, c1) * at(transform, r2, c2) -
                             at(transform, r1, c2) * at(transform, r2, c1);
        }
    }

    // Products of floats are exact in double, but their sums are not: a determinant below the
    // rounding of its own terms cannot be told from zero.
    double determinant = 0;
    double magnitude = 0;
    for (std::size_t c = 0; c < 3; ++c) {
        determinant += at(transform, 0, c) * adjugate[c][0];
        for (std::size_t k = 1; k < 3; ++k) {
            const std::size_t other = 3 - k;
            magnitude += std::abs(at(transform, 0, c) * at(transform, k, (c + 1) % 3) *
                                  at(transform, other, (c + 2) % 3));
        }
    }
    constexpr double rounding = 4 * std::numeric_limits<double>::epsilon();
    if (!(std::abs(determinant) > rounding * magnitude) || !std::isfinite(determinant))
        return false;

    Transform result;
    for (std::size_t row = 0; row < 3; ++row) {
        double moved = 0;
        for (std::size_t column = 0; column < 3; ++column) {
            const double element = adjugate[row][column] / determinant;
            result.m[4 * row + column] = static_cast<float>(element);
            moved -= element * translation(transform, column);
        }
        result.m[4 * row + 3] = static_cast<float>(moved);
    }
    if (!std::all_of(result.m.begin(), result.m.end(), [](float x) { return std::isfinite(x); })) {
        return false;
    }
    inverse = result;
    return true;
}

float condition(const Transform& transform) {
    // One-sided Jacobi: rotate pairs of columns until they are orthogonal; their lengths are then
    // the singular values. It never forms A^T A, so small ones keep their digits (Demmel and
    // Veselic, Jacobi's method is more accurate than QR, 1992).
    double column[3][3];
    for (std::size_t c = 0; c < 3; ++c) {
        for (std::size_t r = 0; r < 3; ++r) column[c][r] = at(transform, r, c);
    }
    const auto dot = [&](std::size_t a, std::size_t b) {
        return column[a][0] * column[b][0] + column[a][1] * column[b][1] +
               column[a][2] * column[b][2];
    };
    constexpr int sweeps_max = 16;
    bool rotated = true;
    for (int sweep = 0; sweep < sweeps_max && rotated; ++sweep) {
        rotated = false;
        for (std::size_t a = 0; a < 2; ++a) {
            for (std::size_t b = a + 1; b < 3; ++b) {
                const double aa = dot(a, a), bb = dot(b, b), ab = dot(a, b);
                if (!(std::abs(ab) > 1e-15 * std::sqrt(aa * bb))) continue;
                rotated = true;
                const double zeta = (bb - aa) / (2 * ab);
                const double tangent =
                    std::copysign(1.0, zeta) / (std::abs(zeta) + std::sqrt(1 + zeta * zeta));
                const double cosine = 1 / std::sqrt(1 + tangent * tangent);
                const double sine = cosine * tangent;
                for (std::size_t r = 0; r < 3; ++r) {
                    const double x = column[a][r], y = column[b][r];
                    column[a][r] = cosine * x - sine * y;
                    column[b][r] = sine * x + cosine * y;
                }
            }
        }
    }
    const auto [smallest, largest] = std::minmax({dot(0, 0), dot(1, 1), dot(2, 2)});
    if (!(smallest > 0)) return std::numeric_limits<float>::infinity();
    return static_cast<float>(std::max(1.0, std::sqrt(largest / smallest)));
}

}  // namespace raynest
