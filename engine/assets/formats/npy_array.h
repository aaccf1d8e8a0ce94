// An array in a .npy file, where it lies.
#pragma once

#include "engine/assets/input/import_request.h"
#include "engine/result.h"

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

namespace raynest {

/// The layout of an array in its file.
struct NpyLayout {
    char kind = 'f';       ///< f, i or u, as NumPy writes it
    std::size_t item = 4;  ///< bytes of an element
    bool is_swapped = false;
    bool is_fortran = false;
};

/// `shape` has one to three sides, none of them 0; `values` holds all elements.
struct NpyArray {
    std::vector<std::uint64_t> shape;
    NpyLayout layout;
    std::string_view values;
    std::uint64_t count = 0;  ///< the product of `shape`

    /// Returns the number of elements under a first index.
    [[nodiscard]] std::uint64_t width() const { return count / shape[0]; }
    /// Returns an element: `row` is its first index, `i` < width() numbers the rest in C order.
    [[nodiscard]] double at(std::uint64_t row, std::uint64_t i) const;
};

/// Checks a .npy file of real numbers of at most 64 bits. The bytes in the file bound its shape.
Result<NpyArray> parse_npy(const NamedBytes& file, const ImportLimits& limits);

/// Returns an error: "'NAME' WHY".
[[nodiscard]] tl::unexpected<Error> refuse_array(const std::string& name, const std::string& why);

}  // namespace raynest
