#include "client/files/npy.h"

#include <algorithm>
#include <array>
#include <bit>
#include <charconv>
#include <cmath>
#include <cstring>
#include <limits>

namespace raynest::client {
namespace {

constexpr std::string_view magic = "\x93NUMPY";
constexpr std::size_t dimensions_max = 8;
constexpr std::size_t npy_header_bytes_max = 64 << 10;

std::string_view as_text(std::span<const std::byte> bytes) {
    return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

/// Returns the text after 'key': in the header's dict, or nothing.
std::optional<std::string_view> value_of(std::string_view dict, std::string_view key) {
    const std::size_t at = dict.find("'" + std::string(key) + "'");
    if (at == std::string_view::npos) return std::nullopt;
    std::string_view rest = dict.substr(at + key.size() + 2);
    const std::size_t begin = rest.find_first_not_of(": ");
    if (begin == std::string_view::npos) return std::nullopt;
    return rest.substr(begin);
}

/// "(3, 8), ..." -> {3, 8}
std::optional<std::vector<std::uint64_t>> parse_shape(std::string_view text) {
    const std::size_t end = text.find(')');
    if (text.empty() || text.front() != '(' || end == std::string_view::npos) return std::nullopt;
    std::vector<std::uint64_t> shape;
    const char* at = text.data() + 1;
    const char* const stop = text.data() + end;
    while (true) {
        while (at != stop && (*at == ' ' || *at == ',')) ++at;
        if (at == stop) return shape;
        std::uint64_t size = 0;
        const auto [after, error] = std::from_chars(at, stop, size);
        if (error != std::errc{} || shape.size() == dimensions_max) return std::nullopt;
        shape.push_back(size);
        at = after;
    }
}

/// Returns the product of the shape and the element size; nothing if it exceeds 64 bits.
std::optional<std::uint64_t> byte_count(const std::vector<std::uint64_t>& shape,
                                        std::uint64_t element) {
    std::uint64_t bytes = element;
    for (const std::uint64_t size : shape)
        if (__builtin_mul_overflow(bytes, size, &bytes)) return std::nullopt;
    return bytes;
}

tl::unexpected<Failure> refuse(std::string why) {
    return fail(Exit::invalid, std::move(why));
}

/// Returns the bytes of an element; nothing for types that are not supported.
std::optional<std::uint64_t> element_bytes(std::string_view dtype) {
    constexpr std::array known = {"f2", "f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8"};
    if (dtype.size() != 3 || std::ranges::find(known, dtype.substr(1)) == known.end())
        return std::nullopt;
    return static_cast<std::uint64_t>(dtype[2] - '0');
}

/// Describes the contents of an array with an unsupported dtype.
std::string contents(std::string_view descr) {
    if (descr.starts_with('[')) return "records with named fields";
    const std::string dtype(descr.substr(1, descr.find('\'', 1) - 1));
    const char kind = dtype.size() > 1 ? dtype[1] : ' ';
    if (kind == 'U' || kind == 'S') return "text (" + dtype + ")";
    if (kind == 'O') return "Python objects";
    if (kind == 'b') return "true and false";
    if (kind == 'f') return "long doubles (" + dtype + ")";
    if (kind == 'c') return "complex numbers (" + dtype + ")";
    return "values of dtype '" + dtype + "'";
}

/// A float16: IEEE 754 binary16.
struct Half {
    std::uint16_t bits;
    explicit operator float() const {
        const int exponent = bits >> 10 & 31;
        const int fraction = bits & 1023;
        constexpr float infinite = std::numeric_limits<float>::infinity();
        float size = exponent == 0 ? std::ldexp(static_cast<float>(fraction), -24)
                                   : std::ldexp(static_cast<float>(fraction + 1024), exponent - 25);
        if (exponent == 31)
            size = fraction == 0 ? infinite : std::numeric_limits<float>::quiet_NaN();
        return std::copysign(size, (bits & 0x8000) != 0 ? -1.0F : 1.0F);
    }
};

template <class Number>
float less_shift(Number value, std::uint64_t column, std::span<const double> less) {
    if (column >= less.size()) return static_cast<float>(value);
    return static_cast<float>(static_cast<double>(value) - less[column]);
}

/// An element, as the file holds it; a Half as float.
template <class Number>
auto element(const Array& array, std::uint64_t row, std::uint64_t column) {
    const std::uint64_t index =
        array.fortran ? column * array.shape[0] + row : row * array.shape[1] + column;
    std::array<std::byte, sizeof(Number)> bytes;
    std::memcpy(bytes.data(), array.bytes.data() + index * sizeof(Number), sizeof(Number));
    if (array.dtype[0] == '>') std::ranges::reverse(bytes);
    const auto stored = std::bit_cast<Number>(bytes);
    if constexpr (std::is_same_v<Number, Half>)
        return static_cast<float>(stored);
    else
        return stored;
}

template <class Number>
void read_rows_of(const Array& array, std::uint64_t first, std::span<float> out,
                  std::span<const double> less) {
    const std::uint64_t columns = array.shape[1];
    for (std::uint64_t i = 0; i < out.size(); ++i) {
        const std::uint64_t column = i % columns;
        out[i] = less_shift(element<Number>(array, first + i / columns, column), column, less);
    }
}

/// Returns `use(Number{})` for the type of the array's elements.
template <class Use>
auto with_type(const Array& array, const Use& use) {
    const char size = array.dtype[2];
    switch (array.dtype[1]) {
        case 'f':
            return size == '8' ? use(double{}) : size == '2' ? use(Half{}) : use(float{});
        case 'i':
            return size == '8'   ? use(std::int64_t{})
                   : size == '2' ? use(std::int16_t{})
                   : size == '1' ? use(std::int8_t{})
                                 : use(std::int32_t{});
        default:
            return size == '8'   ? use(std::uint64_t{})
                   : size == '2' ? use(std::uint16_t{})
                   : size == '1' ? use(std::uint8_t{})
                                 : use(std::uint32_t{});
    }
}

/// Appends little-endian numbers, of which ZIP records consist.
class Writer {
public:
    explicit Writer(std::vector<std::byte>& out) : out_(out) {}
    template <class... Numbers>
    Writer& put(Numbers... numbers) {
        (append(&numbers, sizeof numbers), ...);
        return *this;
    }
    Writer& text(std::string_view text) {
        append(text.data(), text.size());
        return *this;
    }

private:
    void append(const void* data, std::size_t size) {
        const std::size_t end = out_.size();
        out_.resize(end + size);
        std::memcpy(out_.data() + end, data, size);
    }
    std::vector<std::byte>& out_;
};

using U16 = std::uint16_t;
using U32 = std::uint32_t;
using U64 = std::uint64_t;

constexpr U16 zip64_version = 45;
constexpr U16 stored = 0;
constexpr U16 no_time = 0;
constexpr U16 first_day = (1 << 5) | 1;  // 1 January 1980: the same input gives the same file
constexpr U32 see_zip64 = 0xFFFFFFFF;

struct Member {
    std::string name;
    U32 crc = 0;
    U64 size = 0;
    U64 offset = 0;
};

void put_local_header(std::vector<std::byte>& out, const Member& member) {
    Writer(out)
        .put(U32{0x04034B50}, zip64_version, U16{0}, stored, no_time, first_day, member.crc,
             see_zip64, see_zip64, static_cast<U16>(member.name.size()), U16{20})
        .text(member.name)
        .put(U16{1}, U16{16}, member.size, member.size);
}

void put_directory_entry(std::vector<std::byte>& out, const Member& member) {
    Writer(out)
        .put(U32{0x02014B50}, zip64_version, zip64_version, U16{0}, stored, no_time, first_day,
             member.crc, see_zip64, see_zip64, static_cast<U16>(member.name.size()), U16{28},
             U16{0}, U16{0}, U16{0}, U32{0}, see_zip64)
        .text(member.name)
        .put(U16{1}, U16{24}, member.size, member.size, member.offset);
}

void put_end(std::vector<std::byte>& out, U64 members, U64 directory) {
    const U64 end = out.size();
    Writer(out)
        .put(U32{0x06064B50}, U64{44}, zip64_version, zip64_version, U32{0}, U32{0}, members,
             members, end - directory, directory)
        .put(U32{0x07064B50}, U32{0}, end, U32{1})
        .put(U32{0x06054B50}, U16{0xFFFF}, U16{0xFFFF}, U16{0xFFFF}, U16{0xFFFF}, see_zip64,
             see_zip64, U16{0});
}

}  // namespace

Result<std::optional<NpyHeader>> read_npy_header(std::span<const std::byte> begin) {
    if (!as_text(begin).starts_with(magic.substr(0, begin.size())))
        return refuse("is not a .npy file; save its array with numpy.save(FILE, array)");
    if (begin.size() < 12) return std::nullopt;
    const auto version = static_cast<unsigned char>(begin[6]);
    std::size_t header_bytes = 0;
    const std::size_t length_bytes = version == 1 ? 2 : 4;
    if (version < 1 || version > 3) return refuse("has an unknown .npy version");
    std::memcpy(&header_bytes, begin.data() + 8, length_bytes);
    if (header_bytes > npy_header_bytes_max)
        return refuse("has a header of " + std::to_string(header_bytes) + " bytes; at most " +
                      std::to_string(npy_header_bytes_max) + " are read");
    if (header_bytes > begin.size() - 8 - length_bytes) return std::nullopt;

    const std::string_view dict = as_text(begin.subspan(8 + length_bytes, header_bytes));
    const auto descr = value_of(dict, "descr");
    const auto order = value_of(dict, "fortran_order");
    const auto shape_text = value_of(dict, "shape");
    if (!descr || !order || !shape_text) return refuse("has no array header");
    const bool plain = descr->size() >= 5 && descr->front() == '\'';
    const auto element_size =
        element_bytes(plain ? descr->substr(1, descr->find('\'', 1) - 1) : "");
    if (!element_size) {
        const bool records = descr->starts_with('[');
        return refuse("holds " + contents(*descr) + ", not real numbers of 64 bits at most; save " +
                      (records ? "numpy.lib.recfunctions.structured_to_unstructured(array)"
                               : "array.astype(numpy.float64)"));
    }

    NpyHeader header;
    header.array.dtype = std::string(descr->substr(1, 3));
    header.array.fortran = order->starts_with("True");
    const auto shape = parse_shape(*shape_text);
    if (!shape) return refuse("has a shape that cannot be read");
    header.array.shape = *shape;
    header.begin = 8 + length_bytes + header_bytes;
    const auto bytes = byte_count(*shape, *element_size);
    if (!bytes) return refuse("has a shape of more bytes than any file has");
    header.bytes = *bytes;
    return header;
}

Result<Array> parse_npy(std::span<const std::byte> file) {
    if (file.empty()) return refuse("is empty");
    auto header = read_npy_header(file);
    if (!header) return tl::unexpected<Failure>(header.error());
    if (!*header) return refuse("is cut within its header");
    Array array = std::move((*header)->array);
    array.bytes = file.subspan((*header)->begin);
    if ((*header)->bytes != array.bytes.size()) return refuse("is not as long as its shape says");
    return array;
}

bool has_float_rows(const Array& array) {
    const bool one = array.shape[0] <= 1 || array.shape[1] <= 1;
    return array.dtype == "<f4" && (!array.fortran || one);
}

void read_rows(const Array& array, std::uint64_t first, std::span<float> out,
               std::span<const double> less) {
    with_type(array, [&]<class Number>(Number) { read_rows_of<Number>(array, first, out, less); });
}

double value_at(const Array& array, std::uint64_t row, std::uint64_t column) {
    return with_type(array, [&]<class Number>(Number) {
        return static_cast<double>(element<Number>(array, row, column));
    });
}

std::vector<std::byte> format_npy(const Array& array) {
    std::string header = "{'descr': '" + array.dtype + "', 'fortran_order': False, 'shape': (";
    for (const std::uint64_t size : array.shape) header += std::to_string(size) + ", ";
    // A tuple of one number ends with a comma, others do not.
    if (array.shape.size() == 1) header.pop_back();
    if (array.shape.size() > 1) header.resize(header.size() - 2);
    header += "), }";
    // Pad the header so that the array begins at a multiple of 64; a line break ends it.
    const std::size_t unpadded = magic.size() + 4 + header.size() + 1;
    header.append(protocol::padded(unpadded) - unpadded, ' ');
    header += '\n';

    std::vector<std::byte> out;
    out.reserve(magic.size() + 4 + header.size() + array.bytes.size());
    Writer(out)
        .text(magic)
        .put(std::uint8_t{1}, std::uint8_t{0}, static_cast<U16>(header.size()))
        .text(header);
    out.insert(out.end(), array.bytes.begin(), array.bytes.end());
    return out;
}

std::vector<std::byte> format_npz(std::span<const NamedArray> arrays) {
    std::vector<std::byte> out;
    std::vector<Member> members;
    for (const NamedArray& named : arrays) {
        const std::vector<std::byte> npy = format_npy(named.array);
        members.push_back({named.name + ".npy", crc32(npy), npy.size(), out.size()});
        put_local_header(out, members.back());
        out.insert(out.end(), npy.begin(), npy.end());
    }
    const U64 directory = out.size();
    for (const Member& member : members) put_directory_entry(out, member);
    put_end(out, members.size(), directory);
    return out;
}

std::uint32_t crc32(std::span<const std::byte> bytes, std::uint32_t seed) {
    static constexpr auto table = [] {
        std::array<std::uint32_t, 256> entries{};
        for (std::uint32_t i = 0; i < 256; ++i) {
            std::uint32_t value = i;
            for (int bit = 0; bit < 8; ++bit)
                value = (value & 1U) != 0 ? 0xEDB88320U ^ (value >> 1) : value >> 1;
            entries[i] = value;
        }
        return entries;
    }();
    std::uint32_t crc = ~seed;
    for (const std::byte byte : bytes)
        crc = table[(crc ^ static_cast<std::uint32_t>(byte)) & 0xFFU] ^ (crc >> 8);
    return ~crc;
}

}  // namespace raynest::client
