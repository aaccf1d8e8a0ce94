#include "engine/assets/formats/formats.h"
#include "engine/assets/formats/shades.h"
#include "engine/assets/formats/text_reader.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <optional>
#include <utility>

namespace raynest {
namespace {

enum class Number : std::uint8_t { i8, u8, i16, u16, i32, u32, f32, f64 };
constexpr std::array<std::size_t, 8> number_bytes{1, 1, 2, 2, 4, 4, 4, 8};
enum class Encoding : std::uint8_t { ascii, little, big };

struct Property {
    std::string name;
    Number type = Number::f32;
    std::optional<Number> count;  ///< for a list: the type of its length
};
struct Element {
    std::string name;
    std::uint64_t count = 0;
    std::vector<Property> properties;
};
struct Header {
    Encoding encoding = Encoding::ascii;
    std::vector<Element> elements;
    std::size_t bytes = 0;
};

constexpr std::size_t header_bytes_max = 1 << 20;
constexpr std::size_t properties_max = 1024;  ///< in all elements

std::optional<Number> number_named(std::string_view name) {
    constexpr std::array<std::array<std::string_view, 2>, 8> names{{{"char", "int8"},
                                                                    {"uchar", "uint8"},
                                                                    {"short", "int16"},
                                                                    {"ushort", "uint16"},
                                                                    {"int", "int32"},
                                                                    {"uint", "uint32"},
                                                                    {"float", "float32"},
                                                                    {"double", "float64"}}};
    for (std::size_t i = 0; i < names.size(); ++i)
        if (name == names[i][0] || name == names[i][1]) return static_cast<Number>(i);
    return std::nullopt;
}

Result<Property> read_property(TextReader& text) {
    Property property;
    std::string_view type = text.word();
    const bool is_list = type == "list";
    if (is_list) {
        property.count = number_named(text.word());
        type = text.word();
    }
    const auto known = number_named(type);
    property.name = text.word();
    if (!known || property.name.empty() || (is_list && !property.count) ||
        property.count >= Number::f32)
        return text.refuse("is no property that PLY knows");
    property.type = *known;
    return property;
}

Result<Header> read_header(std::span<const std::byte> bytes) {
    TextReader text(bytes.first(std::min(bytes.size(), header_bytes_max)));
    Header header;
    if (text.word() != "ply") return text.refuse("does not begin with 'ply'");
    bool has_format = false;
    std::size_t properties = 0;
    for (text.next_line();; text.next_line()) {
        if (text.at_end())
            return text.refuse("the header has no 'end_header'; the file is cut short");
        const std::string_view key = text.word();
        if (key == "end_header") break;
        if (key == "format") {
            const std::string_view name = text.word();
            has_format = true;
            header.encoding = name == "ascii"                  ? Encoding::ascii
                              : name == "binary_little_endian" ? Encoding::little
                                                               : Encoding::big;
            if (header.encoding == Encoding::big && name != "binary_big_endian")
                return text.refuse(
                    "the format is none of ascii, binary_little_endian, "
                    "binary_big_endian");
        } else if (key == "element") {
            Element& element = header.elements.emplace_back();
            element.name = text.word();
            std::int64_t count = 0;
            if (!text.whole(count) || count < 0 || !text.is_word_end())
                return text.refuse("the element has no count");
            element.count = static_cast<std::uint64_t>(count);
            ++properties;
        } else if (key == "property") {
            auto property = read_property(text);
            if (!property) return tl::unexpected<Error>(property.error());
            if (header.elements.empty()) return text.refuse("a property precedes all elements");
            header.elements.back().properties.push_back(std::move(*property));
            ++properties;
        } else if (key != "comment" && key != "obj_info" && !key.empty()) {
            return text.refuse(fmt::format("'{}' is no line of a PLY header", one_line(key, 40)));
        }
        if (properties > properties_max)
            return text.refuse(fmt::format("the header has over {} properties", properties_max));
    }
    text.next_line();
    if (!has_format) return text.refuse("the header has no 'format'");
    header.bytes = text.offset();
    return header;
}

/// Reads the numbers behind the header in order.
class Values {
public:
    Values(std::span<const std::byte> bytes, Encoding encoding)
        : text_(bytes),
          rest_(bytes),
          encoding_(encoding) {}

    /// False where the file ends, or a word is no number.
    bool read(Number type, double& value) {
        if (encoding_ == Encoding::ascii) {
            while (!text_.number(value)) {
                // A number may stand on the next line.
                if (!text_.rest().empty() || text_.at_end()) return false;
                text_.next_line();
            }
            return true;
        }
        const std::size_t size = number_bytes[static_cast<std::size_t>(type)];
        if (size > rest_.size()) return false;
        std::array<std::byte, 8> bytes{};
        std::memcpy(bytes.data(), rest_.data(), size);
        if (encoding_ == Encoding::big) std::reverse(bytes.data(), bytes.data() + size);
        rest_ = rest_.subspan(size);
        const auto bits = std::bit_cast<std::uint64_t>(bytes);
        switch (type) {
            case Number::i8:
                value = static_cast<std::int8_t>(bits);
                break;
            case Number::i16:
                value = static_cast<std::int16_t>(bits);
                break;
            case Number::i32:
                value = static_cast<std::int32_t>(bits);
                break;
            case Number::f32:
                value = double{std::bit_cast<float>(static_cast<std::uint32_t>(bits))};
                break;
            case Number::f64:
                value = std::bit_cast<double>(bits);
                break;
            default:
                value = static_cast<double>(bits);
                break;
        }
        return true;
    }
    /// Ends a row: in a text each has a line of its own. False if it has more numbers than the header
    /// says.
    bool end_row() {
        if (is_binary()) return true;
        const bool is_whole = text_.is_line_end();
        text_.next_line();
        return is_whole;
    }
    [[nodiscard]] bool is_binary() const { return encoding_ != Encoding::ascii; }
    [[nodiscard]] std::uint64_t left() const {
        return encoding_ == Encoding::ascii ? rest_.size() - text_.offset() : rest_.size();
    }
    /// The least bytes of a number.
    [[nodiscard]] std::uint64_t least(Number type) const {
        return encoding_ == Encoding::ascii ? 1 : number_bytes[static_cast<std::size_t>(type)];
    }
    [[nodiscard]] tl::unexpected<Error> refuse(const Element& element, std::uint64_t row,
                                               const std::string& why) const {
        return fail(
            ErrorCode::scene_invalid,
            fmt::format("{} {} of {}: {}", one_line(element.name, 40), row, element.count, why));
    }

private:
    TextReader text_;
    std::span<const std::byte> rest_;
    Encoding encoding_;
};

constexpr std::string_view cut = "is cut short, or has a word that is no number";

/// The properties of a vertex that are read. Names of several programs stand for the same.
enum Slot { x, y, z, nx, ny, nz, red, green, blue, alpha, radius, slots };
constexpr std::array<std::string_view, slots> slot_names{
    "x", "y", "z", "nx", "ny", "nz", "red", "green", "blue", "alpha", "radius"};

std::size_t slot_of(std::string_view name) {
    if (name.starts_with("diffuse_")) name.remove_prefix(8);
    return static_cast<std::size_t>(std::find(slot_names.begin(), slot_names.end(), name) -
                                    slot_names.begin());
}

class PlyReader {
public:
    explicit PlyReader(Values values) : values_(values) {}

    Result<void> read(const Element& element) {
        std::uint64_t least = 0;
        for (const Property& property : element.properties)
            least += values_.least(property.count.value_or(property.type));
        if (element.count != 0 && (least == 0 || element.count > values_.left() / least)) {
            return fail(ErrorCode::scene_invalid,
                        fmt::format("says that it has {} of '{}', which takes more bytes than "
                                    "follow: it is cut short",
                                    element.count, one_line(element.name, 40)));
        }
        if (element.name == "vertex") return read_vertices(element);
        if (element.name != "face" && element.name != "tristrips") return skip(element);
        if (!geometry_.positions.empty()) return read_faces(element);
        early_.emplace_back(element, values_);
        return skip(element);
    }

    /// Reads the faces that precede the vertices.
    Result<void> finish() {
        for (const auto& [element, values] : early_) {
            values_ = values;
            if (auto done = read_faces(element); !done) return done;
        }
        return {};
    }

    FileContent take() {
        FileContent content;
        if (geometry_.rest.indices.empty() && !has_faces_) {
            content.points = std::move(geometry_.positions);
            content.radii = std::move(radii_);
            content.point_colours = std::move(geometry_.rest.colours);
        } else {
            content.objects.push_back({});
            content.objects.back().geometries.push_back(std::move(geometry_));
        }
        content.is_float32 = is_float32_;
        if (long_rows_ != 0)
            content.warnings.push_back(
                fmt::format("{} more numbers than the header says, which are left out",
                            counted(long_rows_, "row has", "rows have")));
        if (has_face_colours_) content.warnings.emplace_back(face_colours_left_out);
        return content;
    }

private:
    Result<void> read_vertices(const Element& element) {
        if (!geometry_.positions.empty())
            return fail(ErrorCode::scene_invalid, "has two elements 'vertex'");
        std::vector<std::size_t> places;  // each property's among the slots
        std::array<Number, slots> types{};
        std::array<bool, slots> has{};
        for (const Property& property : element.properties) {
            const std::size_t slot = property.count ? std::size_t{slots} : slot_of(property.name);
            places.push_back(slot);
            if (slot == slots) continue;
            has[slot] = true;
            types[slot] = property.type;
        }
        if (!(has[x] && has[y] && has[z]))
            return fail(ErrorCode::scene_invalid, "its vertices have no properties x, y and z");
        is_float32_ = types[x] == Number::f32 && values_.is_binary();
        geometry_.positions.reserve(element.count);
        std::array<double, slots> of{};
        for (std::uint64_t row = 0; row < element.count; ++row) {
            for (std::size_t i = 0; i < places.size(); ++i) {
                double value = 0;
                const Property& property = element.properties[i];
                if (property.count ? !skip_list(property) : !values_.read(property.type, value))
                    return values_.refuse(element, row, std::string(cut));
                if (places[i] != slots) of[places[i]] = value;
            }
            end_row();
            geometry_.positions.emplace_back(of[x], of[y], of[z]);
            if (has[nx] && has[ny] && has[nz])
                geometry_.rest.normals.push_back(Vec3(glm::dvec3(of[nx], of[ny], of[nz])));
            if (has[radius]) radii_.push_back(of[radius]);
            if (!(has[red] && has[green] && has[blue])) continue;
            for (const Slot channel : {red, green, blue, alpha})
                geometry_.rest.colours.push_back(has[channel] ? shade(types[channel], of[channel])
                                                              : 255);
        }
        return {};
    }

    /// A byte of a colour; floats go to 1.
    static std::uint8_t shade(Number type, double value) {
        const double most = type >= Number::f32 ? 1 : type == Number::u16 ? 65535 : 255;
        const double share = value > 0 ? std::min(value / most, 1.0) : 0;
        return static_cast<std::uint8_t>(std::lround(share * 255));
    }

    /// Reads a list's length; false if more is announced than the file has.
    bool read_length(const Property& list, std::uint64_t& length) {
        double value = 0;
        if (!values_.read(*list.count, value) || !(value >= 0)) return false;
        if (value > static_cast<double>(values_.left() / values_.least(list.type))) return false;
        length = static_cast<std::uint64_t>(value);
        return true;
    }
    bool skip_list(const Property& list) {
        std::uint64_t length = 0;
        if (!read_length(list, length)) return false;
        double ignored = 0;
        for (std::uint64_t i = 0; i < length; ++i)
            if (!values_.read(list.type, ignored)) return false;
        return true;
    }

    /// Appends the triangles of strips: each corner makes one with the two before it, turned the other
    /// way each time. `no_id` ends a strip.
    void add_strips(const std::vector<std::uint32_t>& corners) {
        std::size_t first = 0;
        for (std::size_t i = 0; i < corners.size(); ++i) {
            if (corners[i] == no_id) first = i + 1;
            if (i < first + 2) continue;
            const std::size_t turned = (i - first) % 2;
            geometry_.rest.indices.insert(
                geometry_.rest.indices.end(),
                {corners[i - 2 + turned], corners[i - 1 - turned], corners[i]});
        }
    }

    /// Reads faces or strips of triangles.
    Result<void> read_faces(const Element& element) {
        const bool are_strips = element.name == "tristrips";
        has_faces_ = has_faces_ || element.count != 0;
        has_face_colours_ =
            has_face_colours_ ||
            (element.count != 0 && std::ranges::any_of(element.properties, [](const Property& p) {
                 return slot_of(p.name) == red;
             }));
        std::vector<std::uint32_t> corners, triangles;
        for (std::uint64_t row = 0; row < element.count; ++row) {
            corners.clear();
            for (const Property& property : element.properties) {
                double value = 0;
                std::uint64_t length = 0;
                const bool is_corners = property.count && (property.name == "vertex_indices" ||
                                                           property.name == "vertex_index");
                if (!is_corners) {
                    if (property.count ? !skip_list(property) : !values_.read(property.type, value))
                        return values_.refuse(element, row, std::string(cut));
                    continue;
                }
                if (!read_length(property, length))
                    return values_.refuse(
                        element, row,
                        "has more corners than the file has numbers: it is cut short");
                for (std::uint64_t i = 0; i < length; ++i) {
                    if (!values_.read(property.type, value))
                        return values_.refuse(element, row, std::string(cut));
                    if (are_strips && value == -1) {
                        corners.push_back(no_id);
                        continue;
                    }
                    if (!(value >= 0 && value < static_cast<double>(geometry_.positions.size())))
                        return values_.refuse(element, row,
                                              fmt::format("uses vertex {} of {}: they count from 0",
                                                          value, geometry_.positions.size()));
                    corners.push_back(static_cast<std::uint32_t>(value));
                }
            }
            end_row();
            if (are_strips) add_strips(corners);
            if (are_strips || corners.size() < 3) continue;
            triangles.clear();
            triangulate(geometry_.positions, corners, triangles);
            for (const std::uint32_t place : triangles)
                geometry_.rest.indices.push_back(corners[place]);
        }
        return {};
    }

    Result<void> skip(const Element& element) {
        double ignored = 0;
        for (std::uint64_t row = 0; row < element.count; ++row) {
            for (const Property& property : element.properties)
                if (property.count ? !skip_list(property) : !values_.read(property.type, ignored))
                    return values_.refuse(element, row, std::string(cut));
            values_.end_row();
        }
        return {};
    }
    void end_row() { long_rows_ += values_.end_row() ? 0U : 1U; }

    Values values_;
    FileGeometry geometry_;
    std::vector<double> radii_;
    std::vector<std::pair<Element, Values>> early_;  ///< faces before all vertices, and where
    bool has_faces_ = false;
    bool has_face_colours_ = false;
    bool is_float32_ = false;
    std::uint64_t long_rows_ = 0;  ///< with more numbers than the header says
};

}  // namespace

Result<FileContent> read_ply(const ImportRequest& request, const ImportLimits&) {
    const std::span<const std::byte> bytes = request.files.front().bytes;
    const auto header = read_header(bytes);
    if (!header) return tl::unexpected<Error>(header.error());
    PlyReader reader({bytes.subspan(header->bytes), header->encoding});
    for (const Element& element : header->elements)
        if (auto done = reader.read(element); !done) return tl::unexpected<Error>(done.error());
    if (auto done = reader.finish(); !done) return tl::unexpected<Error>(done.error());
    return reader.take();
}

}  // namespace raynest
