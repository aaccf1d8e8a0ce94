// Node transforms: converts a matrix or TRS to one 3x4 map in double precision.
#include "engine/assets/gltf/file/model.h"

#include <algorithm>
#include <cmath>

namespace raynest::gltf {
namespace {

bool fits_float(std::span<const double> numbers) {
    for (const double number : numbers) {
        if (!std::isfinite(static_cast<float>(number))) return false;
    }
    return true;
}

}  // namespace

Result<Matrix> local_matrix(std::span<const double> matrix, std::span<const double> translation,
                            std::span<const double> rotation, std::span<const double> scale,
                            const std::string& where) {
    const auto wrong = [](std::span<const double> numbers, std::size_t size) {
        return !numbers.empty() && numbers.size() != size;
    };
    if (wrong(matrix, 16) || wrong(translation, 3) || wrong(rotation, 4) || wrong(scale, 3)) {
        return fail(ErrorCode::scene_invalid, where + " has a transform of the wrong length");
    }
    if (!fits_float(matrix) || !fits_float(translation) || !fits_float(rotation) ||
        !fits_float(scale)) {
        return fail(ErrorCode::scene_invalid, where + " has a transform that does not fit a float");
    }
    if (!matrix.empty()) {
        if (!translation.empty() || !rotation.empty() || !scale.empty()) {
            return fail(ErrorCode::scene_invalid,
                        where + " has a matrix and TRS; only one may be given");
        }
        // A last row of zeros is accepted only with an all-zero matrix: singular, not projective.
        const double row = std::abs(matrix[3]) + std::abs(matrix[7]) + std::abs(matrix[11]);
        const bool is_zero = std::ranges::all_of(matrix, [](double x) { return x == 0; });
        if (row > 1e-4 || (std::abs(matrix[15] - 1) > 1e-4 && !is_zero)) {
            return fail(ErrorCode::scene_invalid,
                        where + " has a projective matrix, not an affine one");
        }
        Matrix out{};
        for (std::size_t r = 0; r < 3; ++r) {
            for (std::size_t column = 0; column < 4; ++column) {
                out[r * 4 + column] = matrix[column * 4 + r];
            }
        }
        return out;
    }

    const double no_translation[3] = {0, 0, 0};
    const double no_rotation[4] = {0, 0, 0, 1};
    const double no_scale[3] = {1, 1, 1};
    double length = 1;
    if (!rotation.empty()) {
        length =
            std::hypot(std::hypot(rotation[0], rotation[1]), std::hypot(rotation[2], rotation[3]));
    }
    if (length < 1e-12) {
        return fail(ErrorCode::scene_invalid, where + " has a rotation of length zero");
    }
    return from_trs(translation.empty() ? no_translation : translation.data(),
                    rotation.empty() ? no_rotation : rotation.data(),
                    scale.empty() ? no_scale : scale.data());
}

}  // namespace raynest::gltf
