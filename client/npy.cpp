#include "client/npy.h"

#include <array>
#include <charconv>
#include <cstring>
#include <optional>

namespace raynest::client {
namespace {

constexpr std::string_view magic = "\x93NUMPY";
constexpr std::size_t dimensions_max = 8;

std::string_view as_text(std::span<const std::byte> bytes) {
    return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

/// The text behind 'key': in the header's dict, or nothing.
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

/// Product of the shape and the element size; nothing when it does not fit 64 bits.
std::optional<std::uint64_t> byte_count(const std::vector<std::uint64_t>& shape,
                                        std::uint64_t element) {
    std::uint64_t bytes = element;
    for (const std::uint64_t size : shape)
        if (__builtin_mul_overflow(bytes, size, &bytes)) return std::nullopt;
    return bytes;
}

tl::unexpected<Failure> refuse(const char* why) {
    return fail(Exit::invalid, why);
}

/// Appends little-endian numbers: the shape of every ZIP record.
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

Result<Array> parse_npy(std::span<const std::byte> file) {
    if (file.size() < 10 || as_text(file.first(magic.size())) != magic)
        return refuse("is not a .npy file");
    const auto version = static_cast<unsigned char>(file[6]);
    std::size_t header_bytes = 0;
    const std::size_t length_bytes = version == 1 ? 2 : 4;
    if (version < 1 || version > 3 || file.size() < 8 + length_bytes)
        return refuse("has an unknown .npy version");
    std::memcpy(&header_bytes, file.data() + 8, length_bytes);
    if (header_bytes > file.size() - 8 - length_bytes) return refuse("is cut within its header");

    const std::string_view dict = as_text(file.subspan(8 + length_bytes, header_bytes));
    const auto descr = value_of(dict, "descr");
    const auto order = value_of(dict, "fortran_order");
    const auto shape_text = value_of(dict, "shape");
    if (!descr || !order || !shape_text || descr->size() < 5 || descr->front() != '\'')
        return refuse("has no array header");
    if (order->rfind("False", 0) != 0)
        return refuse("is in Fortran order; save numpy.ascontiguousarray(...)");

    Array array;
    array.dtype = std::string(descr->substr(1, descr->find('\'', 1) - 1));
    const auto shape = parse_shape(*shape_text);
    if (!shape) return refuse("has a shape that cannot be read");
    array.shape = *shape;
    const bool sized = array.dtype.size() == 3 && array.dtype[2] >= '1' && array.dtype[2] <= '8';
    if (!sized || array.dtype[0] == '>')
        return refuse("holds neither little-endian numbers nor bytes");
    const auto bytes = byte_count(array.shape, static_cast<std::uint64_t>(array.dtype[2] - '0'));
    array.bytes = file.subspan(8 + length_bytes + header_bytes);
    if (!bytes || *bytes != array.bytes.size()) return refuse("is not as long as its shape says");
    return array;
}

std::vector<std::byte> format_npy(const Array& array) {
    std::string header = "{'descr': '" + array.dtype + "', 'fortran_order': False, 'shape': (";
    for (const std::uint64_t size : array.shape) header += std::to_string(size) + ", ";
    // One dimension keeps its comma; more lose it.
    if (array.shape.size() == 1) header.pop_back();
    if (array.shape.size() > 1) header.resize(header.size() - 2);
    header += "), }";
    // The array begins at a multiple of 64, and the header ends with a line break.
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
