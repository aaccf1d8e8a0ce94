// Reads and writes NumPy's .npy files, and writes .npz files.
//
// A .npy is a magic, a header in the form of a Python dict, and the raw array; a .npz is a ZIP
// archive of .npy files. This client writes C order and little endian. It also reads Fortran order,
// big endian and all sizes of real numbers.
#pragma once

#include "client/ground/failure.h"
#include "protocol/buffer.h"

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

namespace raynest::client {

/// An array in memory; dtype in NumPy's notation ("<f4", "<u8", "|u1").
struct Array {
    std::string dtype;
    std::vector<std::uint64_t> shape;
    std::span<const std::byte> bytes;
    bool fortran = false;  ///< stored column by column
};

/// The contents of a .npy according to its header.
struct NpyHeader {
    Array array;              ///< without its bytes
    std::uint64_t begin = 0;  ///< where the array begins in the file
    std::uint64_t bytes = 0;  ///< the array's
};
/// Reads the header alone; nothing where `begin` ends within it. Exit code 5 as parse_npy().
Result<std::optional<NpyHeader>> read_npy_header(std::span<const std::byte> begin);

/// Reads the header of a .npy; `bytes` of the result points into `file`. Exit code 5 if `file` is
/// no .npy, holds anything but floats and integers, or has not the length of its shape.
Result<Array> parse_npy(std::span<const std::byte> file);

/// True if the array's rows in memory are already those that read_rows() would give.
[[nodiscard]] bool has_float_rows(const Array& array);
/// Fills `out` with rows of a two-dimensional array from `first` on. Subtracts `less` from the
/// first columns, in double, before it rounds them to float32.
void read_rows(const Array& array, std::uint64_t first, std::span<float> out,
               std::span<const double> less = {});

/// One number of a two-dimensional array.
[[nodiscard]] double value_at(const Array& array, std::uint64_t row, std::uint64_t column);

/// Returns the whole file.
[[nodiscard]] std::vector<std::byte> format_npy(const Array& array);

struct NamedArray {
    std::string name;  ///< key in the .npz
    Array array;
};
/// Returns an archive of NAME.npy members: not compressed, ZIP64, so that sizes have no limit.
[[nodiscard]] std::vector<std::byte> format_npz(std::span<const NamedArray> arrays);

/// CRC-32 as ZIP uses it (reflected polynomial 0xEDB88320).
[[nodiscard]] std::uint32_t crc32(std::span<const std::byte> bytes, std::uint32_t seed = 0);

}  // namespace raynest::client
