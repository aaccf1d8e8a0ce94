#include "engine/assets/composition/matrix_table.h"

#include "engine/assets/formats/npy_array.h"
#include "engine/assets/input/messages.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstdint>

namespace raynest::composition {

Result<std::vector<Matrix>> read_matrices(const NamedBytes& file, const ImportLimits& limits) {
    const auto array = parse_npy(file, limits);
    if (!array) return tl::unexpected(array.error());
    using Shape = std::vector<std::uint64_t>;
    const Shape row_shape(array->shape.begin() + 1, array->shape.end());
    if (row_shape != Shape{3} && row_shape != Shape{3, 4} && row_shape != Shape{4, 4})
        return refuse_array(one_line(file.name),
                            "holds neither offsets nor matrices: its shape is to be (N, 3), "
                            "(N, 3, 4) or (N, 4, 4)");
    const std::uint64_t width = array->width();
    if (array->shape[0] > limits.instances_max)
        return fail(ErrorCode::limit_exceeded,
                    fmt::format("'{}' has {} rows; at most {} are allowed", one_line(file.name),
                                array->shape[0], limits.instances_max));
    std::vector<Matrix> made(array->shape[0], Matrix(1));
    for (std::uint64_t row = 0; row < made.size(); ++row) {
        for (std::uint64_t i = 12; i < width; ++i)
            if (array->at(row, i) != (i == 15 ? 1 : 0))
                return refuse_array(
                    one_line(file.name),
                    fmt::format("has a matrix, number {}, whose last row is not 0 0 0 1: rows "
                                "of a matrix stand one behind the other",
                                row));
        for (std::uint64_t i = 0; i < std::min<std::uint64_t>(width, 12); ++i) {
            const int at = static_cast<int>(i);
            (width == 3 ? made[row][3][at] : made[row][at % 4][at / 4]) = array->at(row, i);
        }
    }
    return made;
}

}  // namespace raynest::composition
