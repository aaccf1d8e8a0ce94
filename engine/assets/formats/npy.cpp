#include "engine/assets/formats/npy.h"

#include "engine/scene/precision.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <bit>
#include <charconv>
#include <cmath>
#include <cstring>
#include <limits>
#include <optional>
#include <set>
#include <span>
#include <string_view>

namespace raynest {
namespace {

struct Array {
    std::vector<std::uint64_t> shape;
    std::vector<float> values;
    double rounding = 0;       ///< largest distance by which float32 rounding moved a point
    double file_rounding = 0;  ///< the same, before the file was written
};

/// The point in each row of an array, and the origin to subtract from it.
struct Points {
    std::array<std::size_t, 3> columns;
    WorldPoint origin;
};
constexpr std::array<std::size_t, 3> record_point{0, 1, 2};
constexpr std::array<std::size_t, 3> matrix_point{3, 7, 11};  ///< the translation of a 3x4 matrix

tl::unexpected<Error> refuse(const std::string& name, const std::string& why) {
    return fail(ErrorCode::scene_invalid, fmt::format("'{}' {}", name, why));
}

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
        std::uint64_t extent = 0;
        const auto [next, error] = std::from_chars(at, end, extent);
        if (error != std::errc{} || shape.size() == 3) return false;
        shape.push_back(extent);
        at = next;
        while (at != end && (*at == ',' || *at == ' ')) ++at;
    }
    return at != end;
}

/// The layout of an array in its file.
struct Layout {
    char kind = 'f';       ///< f, i or u, as NumPy writes it
    std::size_t item = 4;  ///< bytes of an element
    bool is_swapped = false;
    bool is_fortran = false;
};

/// Reads "'<f4', ..."; nothing for what is no real number of at most 64 bits.
std::optional<Layout> parse_descr(std::string_view text) {
    constexpr std::array known = {"f2", "f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8"};
    if (text.size() < 5 || text[0] != '\'' || text[4] != '\'') return std::nullopt;
    if (std::find(known.begin(), known.end(), text.substr(2, 2)) == known.end())
        return std::nullopt;
    return Layout{text[2], static_cast<std::size_t>(text[3] - '0'), text[1] == '>', false};
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

double read(const char* at, const Layout& layout) {
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

/// Reads a file: magic, version, header length (2 bytes; 4 from version 2 on), a Python dictionary,
/// values.
Result<Array> read_array(const NamedBytes& file, const ImportLimits& limits, const Points& points) {
    constexpr std::string_view magic = "\x93NUMPY";
    const std::string_view bytes(reinterpret_cast<const char*>(file.bytes.data()),
                                 file.bytes.size());
    if (!bytes.starts_with(magic) || bytes.size() < 12)
        return refuse(file.name, "is not a .npy file");
    const auto byte_at = [&](std::size_t i) { return static_cast<unsigned char>(bytes[i]); };
    const bool long_header = byte_at(6) >= 2;
    std::size_t header_bytes = byte_at(8) | static_cast<std::size_t>(byte_at(9)) << 8;
    if (long_header) {
        header_bytes |= static_cast<std::size_t>(byte_at(10)) << 16 |
                        static_cast<std::size_t>(byte_at(11)) << 24;
    }
    const std::size_t header_at = long_header ? 12 : 10;
    if (header_bytes > bytes.size() - header_at) return refuse(file.name, "is cut short");
    const std::string_view header = bytes.substr(header_at, header_bytes);

    Array array;
    auto layout = parse_descr(member(header, "descr"));
    if (!layout) {
        return refuse(file.name,
                      "must hold real numbers of at most 64 bits (array.astype(numpy.float32))");
    }
    layout->is_fortran = member(header, "fortran_order").starts_with("True");
    if (!parse_shape(member(header, "shape"), array.shape) || array.shape.empty()) {
        return refuse(file.name, "has no shape of one to three numbers");
    }

    // The bytes in the file bound the product before it is used.
    const std::string_view values = bytes.substr(header_at + header_bytes);
    std::uint64_t count = 1;
    for (const std::uint64_t extent : array.shape) {
        if (extent == 0 || extent > limits.file_bytes_max ||
            count > limits.file_bytes_max / extent) {
            return refuse(file.name, extent == 0 ? "holds nothing: a side of its shape is 0"
                                                 : "has a shape of more bytes than a file has");
        }
        count *= extent;
    }
    if (count > values.size() / layout->item) return refuse(file.name, "is cut short");

    array.values.resize(count);
    const std::uint64_t width = count / array.shape[0];
    std::vector<double> shift(width);
    std::vector<bool> is_point(width);
    for (std::size_t axis = 0; axis < 3; ++axis) {
        const std::size_t column = points.columns[axis];
        if (column < width) shift[column] = points.origin[axis], is_point[column] = true;
    }
    std::uint64_t bad = 0;
    double moved_max = 0;  // squared, as is `moved`
    const bool is_float32 = layout->kind == 'f' && layout->item == 4;
    for (std::uint64_t row = 0; row < count; row += width) {
        double moved = 0;
        Vec3 stated(0);
        int stated_axis = 0;
        for (std::uint64_t i = 0; i < width; ++i) {
            const std::uint64_t place =
                place_of(array.shape, width, row / width, i, layout->is_fortran);
            const double value = read(values.data() + place * layout->item, *layout);
            const double exact = value - shift[i];
            const auto rounded = static_cast<float>(exact);
            array.values[row + i] = rounded;
            bad += std::isfinite(rounded) ? 0U : 1U;
            if (!is_point[i]) continue;
            const double off = double{rounded} - exact;
            moved += off * off;
            stated[stated_axis++] = static_cast<float>(value);
        }
        moved_max = std::max(moved_max, moved);
        if (is_float32) array.file_rounding = std::max(array.file_rounding, half_step(stated));
    }
    array.rounding = std::sqrt(moved_max);
    if (bad != 0)
        return refuse(file.name, fmt::format("has {} values that are not finite float32", bad));
    return array;
}

void note_rounding(const Array& array, SceneDescription& scene) {
    scene.rounding = std::max(scene.rounding, array.rounding);
    scene.file_rounding = std::max(scene.file_rounding, array.file_rounding);
}

/// True if a record's first three values are its position, so that its bounds move with them.
bool moves_with_point(const PackPrimitive& primitive, std::span<const float> example) {
    std::vector<float> record(example.begin(), example.end());
    Box before;
    Box after;
    primitive.bounds(record.data(), 1, &before);
    const float step = 1 + glm::length(glm::max(glm::abs(before.lower), glm::abs(before.upper)));
    for (const std::size_t axis : record_point) record[axis] += step;
    primitive.bounds(record.data(), 1, &after);
    const auto moved = [&](const Vec3& from, const Vec3& to) {
        const Vec3 off = glm::abs(to - from - Vec3(step));
        return std::max({off.x, off.y, off.z}) <= 1e-5F * step;
    };
    return moved(before.lower, after.lower) && moved(before.upper, after.upper);
}

/// Returns the names of all record types, each once.
std::set<std::string_view> primitive_names(const Registry& registry) {
    std::set<std::string_view> names;
    for (const Pack* pack : registry.packs())
        for (const PackPrimitive& primitive : std::span(pack->primitives, pack->primitive_count))
            names.insert(primitive.name);
    return names;
}

Result<ObjectDescription> read_records(const ImportRequest& request, const ImportLimits& limits,
                                       const Registry& registry, const WorldPoint& origin,
                                       SceneDescription& scene) {
    const NamedBytes& file = request.files.front();
    const PackPrimitive* primitive =
        request.primitive.empty() ? nullptr : registry.find_primitive(request.primitive);
    if (primitive == nullptr) {
        return fail(
            ErrorCode::scene_invalid,
            fmt::format("there is no primitive type '{}' for the records of '{}'; `primitive` is "
                        "one of {}",
                        request.primitive, file.name, fmt::join(primitive_names(registry), ", ")));
    }
    auto array = read_array(file, limits, {record_point, origin});
    if (!array) return tl::unexpected<Error>(array.error());
    if (array->shape.size() != 2 || array->shape[1] * 4 != primitive->record_size) {
        return refuse(file.name, fmt::format("must have shape (N, {}) for primitives of type '{}'",
                                             primitive->record_size / 4, request.primitive));
    }
    const std::uint64_t count = array->shape[0];
    if (count > limits.triangles_max) {
        return fail(ErrorCode::limit_exceeded,
                    fmt::format("the scene has more than {} primitives", limits.triangles_max));
    }

    const std::uint64_t width = array->shape[1];
    if (origin != WorldPoint{} &&
        (width < 3 || !moves_with_point(*primitive, std::span(array->values).first(width)))) {
        return fail(ErrorCode::scene_unsupported,
                    fmt::format("the first three values of a {} are not its position, so no origin "
                                "can be subtracted from them: subtract it before saving",
                                request.primitive));
    }
    note_rounding(*array, scene);

    ObjectDescription object;
    object.name = request.primitive + "s";
    object.record_type = request.primitive;
    const auto bytes = std::as_bytes(std::span(array->values));
    object.records.assign(bytes.begin(), bytes.end());
    object.record_bounds.resize(count);
    primitive->bounds(object.records.data(), count, object.record_bounds.data());
    return object;
}

Result<std::vector<InstanceDescription>> read_instances(const NamedBytes& file,
                                                        const ImportLimits& limits,
                                                        const WorldPoint& origin,
                                                        SceneDescription& scene) {
    auto array = read_array(file, limits, {matrix_point, origin});
    if (!array) return tl::unexpected<Error>(array.error());
    const std::vector<std::uint64_t>& shape = array->shape;
    const bool flat = shape.size() == 2 && shape[1] == 12;
    const bool rows = shape.size() == 3 && shape[1] == 3 && shape[2] == 4;
    if (!flat && !rows) return refuse(file.name, "must have shape (M, 12) or (M, 3, 4)");
    if (shape[0] > limits.instances_max) {
        return fail(ErrorCode::limit_exceeded,
                    fmt::format("the scene has more than {} instances", limits.instances_max));
    }
    note_rounding(*array, scene);
    std::vector<InstanceDescription> instances(shape[0]);
    for (std::size_t i = 0; i < instances.size(); ++i) {
        instances[i].object = 0;
        instances[i].uid = static_cast<std::uint32_t>(i);
        std::copy_n(array->values.data() + 12 * i, 12, instances[i].transform.m.begin());
    }
    return instances;
}

}  // namespace

Result<SceneDescription> describe_npy(const ImportRequest& request, const ImportLimits& limits,
                                      const Registry& registry) {
    SceneDescription scene;
    scene.origin = request.origin;
    // If there are placements, records lie around zero and the placements are in the world.
    const bool is_placed = request.files.size() > 1;
    auto object =
        read_records(request, limits, registry, is_placed ? WorldPoint{} : scene.origin, scene);
    if (!object) return tl::unexpected<Error>(object.error());
    scene.objects.push_back(std::move(*object));
    for (std::size_t i = 1; i < request.files.size(); ++i) {
        if (scene.root != 0)
            return refuse(request.files[i].name, "is not used: give only one file of placements");
        auto instances = read_instances(request.files[i], limits, scene.origin, scene);
        if (!instances) return tl::unexpected<Error>(instances.error());
        scene.objects.push_back({"scene", {}, std::move(*instances), {}, {}, {}, {}});
        scene.root = 1;
    }
    return scene;
}

}  // namespace raynest
