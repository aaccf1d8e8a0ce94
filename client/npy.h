// NumPy's files: .npy in and out, and .npz out.
//
// A .npy is a magic, a header that reads as a Python dict, and the raw array; a .npz is a ZIP
// archive of them. Written are C order and little endian; read are also Fortran order, big endian
// and all sizes of real numbers, as numpy.save leaves them.
#pragma once

#include "client/failure.h"
#include "protocol/buffer.h"

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::client {

/// An array in memory: dtype as NumPy writes it ("<f4", "<u8", "|u1").
struct Array {
    std::string dtype;
    std::vector<std::uint64_t> shape;
    std::span<const std::byte> bytes;
    bool fortran = false;  ///< column by column, rather than row by row
};

/// What a .npy will be, by its header.
struct NpyHeader {
    Array array;              ///< without its bytes
    std::uint64_t begin = 0;  ///< of the array in the file
    std::uint64_t bytes = 0;  ///< of the array
};
/// Reads the header alone; nothing where `begin` ends within it. Exit code 5 as parse_npy().
Result<std::optional<NpyHeader>> read_npy_header(std::span<const std::byte> begin);

/// Reads the header of .npy bytes; `bytes` of the result points into `file`. Exit code 5 when it is
/// no .npy, holds anything but floats and integers, or is not as long as its shape says.
Result<Array> parse_npy(std::span<const std::byte> file);

/// True for an array whose rows lie in memory as read_rows() gives them.
[[nodiscard]] bool has_float_rows(const Array& array);
/// Rows of a two-dimensional array from `first` on, until `out` is full. `less` is subtracted from
/// the first columns, in double, before they are rounded to float32.
void read_rows(const Array& array, std::uint64_t first, std::span<float> out,
               std::span<const double> less = {});

/// One number of a two-dimensional array.
[[nodiscard]] double value_at(const Array& array, std::uint64_t row, std::uint64_t column);

/// The whole file.
[[nodiscard]] std::vector<std::byte> format_npy(const Array& array);

struct NamedArray {
    std::string name;  ///< key in the .npz
    Array array;
};
/// An archive of NAME.npy members, not compressed, in ZIP64: no limit on sizes.
[[nodiscard]] std::vector<std::byte> format_npz(std::span<const NamedArray> arrays);

/// CRC-32 as ZIP uses it (reflected polynomial 0xEDB88320).
[[nodiscard]] std::uint32_t crc32(std::span<const std::byte> bytes, std::uint32_t seed = 0);

}  // namespace raynest::client
