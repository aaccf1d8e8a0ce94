#include "engine/assets/formats/npy_array.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <charconv>
#include <cmath>
#include <cstring>
#include <limits>
#include <optional>

namespace raynest {
namespace {

/// Returns the text after `'key':` in the header's Python dictionary, blanks skipped; empty if
/// absent.
std::string_view member(std::string_view header, std::string_view key) {
    const std::size_t at = header.find(fmt::format("'{}':", key));
    if (at == std::string_view::npos) return {};
    std::string_view rest = header.substr(at + key.size() + 3);
    while (rest.starts_with(' ')) rest.remove_prefix(1);
    return rest;
}

/// Parses "(3, 4), ..." to {3, 4}; false for anything else.
bool parse_shape(std::string_view text, std::vector<std::uint64_t>& shape) {
    if (!text.starts_with('(')) return false;
    const char* at = text.data() + 1;
    const char* const end = text.data() + text.size();
    while (at != end && *at != ')') {
        std::uint64_t length = 0;
        const auto [next, error] = std::from_chars(at, end, length);
        if (error != std::errc{} || shape.size() == 3) return false;
        shape.push_back(length);
        at = next;
        while (at != end && (*at == ',' || *at == ' ')) ++at;
    }
    return at != end;
}

/// Reads "'<f4', ..."; nothing for what is no real number of at most 64 bits.
std::optional<NpyLayout> parse_descr(std::string_view text) {
    constexpr std::array known = {"f2", "f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8"};
    if (text.size() < 5 || text[0] != '\'' || text[4] != '\'') return std::nullopt;
    if (std::find(known.begin(), known.end(), text.substr(2, 2)) == known.end())
        return std::nullopt;
    return NpyLayout{text[2], static_cast<std::size_t>(text[3] - '0'), text[1] == '>', false};
}

template <class Number>
double as(std::uint64_t bits) {
    Number value{};
    std::memcpy(&value, &bits, sizeof value);
    return static_cast<double>(value);
}

/// IEEE 754 binary16.
double half_of(std::uint64_t bits) {
    const auto exponent = static_cast<int>(bits >> 10 & 31);
    const auto fraction = static_cast<int>(bits & 1023);
    double size =
        exponent == 0 ? std::ldexp(fraction, -24) : std::ldexp(fraction + 1024, exponent - 25);
    if (exponent == 31) size = std::numeric_limits<double>::quiet_NaN();  // refused, as infinity is
    return (bits & 0x8000) != 0 ? -size : size;
}

double read(const char* at, const NpyLayout& layout) {
    std::array<char, 8> bytes{};
    std::memcpy(bytes.data(), at, layout.item);
    if (layout.is_swapped) std::reverse(bytes.data(), bytes.data() + layout.item);
    const auto bits = std::bit_cast<std::uint64_t>(bytes);
    const std::size_t item = layout.item;
    if (layout.kind == 'f')
        return item == 4 ? as<float>(bits) : item == 8 ? as<double>(bits) : half_of(bits);
    if (layout.kind == 'i')
        return item == 8   ? as<std::int64_t>(bits)
               : item == 4 ? as<std::int32_t>(bits)
               : item == 2 ? as<std::int16_t>(bits)
                           : as<std::int8_t>(bits);
    return static_cast<double>(bits);
}

/// Returns the number of an element: `row` is its first index, `i` numbers the rest in C order.
std::uint64_t place_of(const std::vector<std::uint64_t>& shape, std::uint64_t width,
                       std::uint64_t row, std::uint64_t i, bool is_fortran) {
    if (!is_fortran) return row * width + i;
    const std::uint64_t last = shape.size() == 3 ? shape[2] : 1;
    return row + shape[0] * (i / last + width / last * (i % last));
}

}  // namespace

tl::unexpected<Error> refuse_array(const std::string& name, const std::string& why) {
    return fail(ErrorCode::scene_invalid, fmt::format("'{}' {}", name, why));
}

double NpyArray::at(std::uint64_t row, std::uint64_t i) const {
    return read(values.data() + place_of(shape, width(), row, i, layout.is_fortran) * layout.item,
                layout);
}

/// Reads a file: magic, version, header length (2 bytes; 4 from version 2 on), a Python dictionary,
/// values.
Result<NpyArray> parse_npy(const NamedBytes& file, const ImportLimits& limits) {
    constexpr std::string_view magic = "\x93NUMPY";
    const std::string_view bytes(reinterpret_cast<const char*>(file.bytes.data()),
                                 file.bytes.size());
    if (!bytes.starts_with(magic) || bytes.size() < 12)
        return refuse_array(file.name, "is not a .npy file");
    const auto byte_at = [&](std::size_t i) { return static_cast<unsigned char>(bytes[i]); };
    const bool long_header = byte_at(6) >= 2;
    std::size_t header_bytes = byte_at(8) | static_cast<std::size_t>(byte_at(9)) << 8;
    if (long_header) {
        header_bytes |= static_cast<std::size_t>(byte_at(10)) << 16 |
                        static_cast<std::size_t>(byte_at(11)) << 24;
    }
    const std::size_t header_at = long_header ? 12 : 10;
    if (header_bytes > bytes.size() - header_at) return refuse_array(file.name, "is cut short");
    const std::string_view header = bytes.substr(header_at, header_bytes);

    NpyArray array;
    const auto layout = parse_descr(member(header, "descr"));
    if (!layout) {
        return refuse_array(
            file.name, "must hold real numbers of at most 64 bits (array.astype(numpy.float32))");
    }
    array.layout = *layout;
    array.layout.is_fortran = member(header, "fortran_order").starts_with("True");
    if (!parse_shape(member(header, "shape"), array.shape) || array.shape.empty()) {
        return refuse_array(file.name, "has no shape of one to three numbers");
    }

    // The bytes in the file bound the product before it is used.
    const std::string_view values = bytes.substr(header_at + header_bytes);
    std::uint64_t count = 1;
    for (const std::uint64_t extent : array.shape) {
        if (extent == 0 || extent > limits.file_bytes_max ||
            count > limits.file_bytes_max / extent) {
            return refuse_array(file.name, extent == 0
                                               ? "holds nothing: a side of its shape is 0"
                                               : "has a shape of more bytes than a file has");
        }
        count *= extent;
    }
    if (count > values.size() / layout->item) return refuse_array(file.name, "is cut short");

    array.values = values;
    array.count = count;
    return array;
}

}  // namespace raynest
