#include "client/files/points.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <iterator>
#include <limits>
#include <utility>

namespace raynest::client {
namespace {

using Bytes = std::vector<std::byte>;

// float32 tells millimetres apart up to here.
constexpr double float32_most = 1e4;
constexpr std::uint64_t las_points_max = std::numeric_limits<std::uint32_t>::max();
constexpr std::size_t las_point_bytes = 28;
constexpr std::size_t las_colour_bytes = 6;
constexpr int las_returns_max = 5;

void append(Bytes& to, const void* from, std::size_t bytes) {
    const auto* const first = static_cast<const std::byte*>(from);
    to.insert(to.end(), first, first + bytes);
}
void append_text(Bytes& to, std::string_view text) {
    append(to, text.data(), text.size());
}
template <class T>
void append_number(Bytes& to, T value) {
    append(to, &value, sizeof value);
}

std::size_t size_of(std::string_view dtype) {
    return static_cast<std::size_t>(dtype[2] - '0');
}

constexpr std::array<std::string_view, 3> colour_names{"red", "green", "blue"};

/// The sRGB of linear light, from 0 to 1.
double srgb_of(float linear) {
    const double share = linear > 0 ? std::min(double{linear}, 1.0) : 0;
    return share <= 0.0031308 ? share * 12.92 : 1.055 * std::pow(share, 1 / 2.4) - 0.055;
}

float float_at(const PointColumn& column, std::size_t number) {
    float value = 0;
    std::memcpy(&value, column.values.data() + sizeof value * number, sizeof value);
    return value;
}

/// Appends the colours of points, each channel from 0 to `most`, as columns of their own.
template <class Channel>
void append_shades(std::vector<PointColumn>& to, const PointColumn& colours, Channel most) {
    for (std::size_t channel = 0; channel < colour_names.size(); ++channel) {
        PointColumn shades{
            std::string(colour_names[channel]), sizeof most == 1 ? "|u1" : "<u2", {}};
        for (std::size_t i = channel; sizeof(float) * i < colours.values.size();
             i += colour_names.size())
            append_number(shades.values, static_cast<Channel>(
                                             std::nearbyint(srgb_of(float_at(colours, i)) * most)));
        to.push_back(std::move(shades));
    }
}

/// PCL's rgb: the bytes of a number that is said to be a float.
PointColumn packed(std::span<const PointColumn> shades) {
    PointColumn made{"rgb", "<f4", {}};
    for (std::size_t point = 0; point < shades[0].values.size(); ++point)
        for (const std::byte byte : {shades[2].values[point], shades[1].values[point],
                                     shades[0].values[point], std::byte{0}})
            made.values.push_back(byte);
    return made;
}

/// Returns the columns of one number each that a file of this ending has for them.
std::vector<PointColumn> columns_of_one(std::string_view ending,
                                        std::span<const PointColumn> columns) {
    std::vector<PointColumn> made;
    for (const PointColumn& column : columns) {
        const bool has_three = column.width == 3 && column.dtype == "<f4";
        if (column.name == "base_colour" && has_three) {
            if (ending == ".las") {
                append_shades(made, column, std::numeric_limits<std::uint16_t>::max());
                continue;
            }
            std::vector<PointColumn> shades;
            append_shades(shades, column, std::numeric_limits<std::uint8_t>::max());
            if (ending == ".pcd")
                made.push_back(packed(shades));
            else
                std::ranges::move(shades, std::back_inserter(made));
            continue;
        }
        const std::size_t size = size_of(column.dtype);
        for (std::uint32_t part = 0; part < column.width; ++part) {
            std::string name = column.name;
            if (column.name == "normal" && has_three)
                name = std::string(ending == ".pcd" ? "normal_" : "n") + "xyz"[part];
            else if (column.width > 1)
                name += "_" + std::to_string(part);
            PointColumn& one = made.emplace_back(PointColumn{std::move(name), column.dtype, {}});
            for (std::size_t at = size * part; at < column.values.size(); at += size * column.width)
                append(one.values, column.values.data() + at, size);
        }
    }
    return made;
}

/// Appends the points, x y z as `real` and then the columns, point by point.
template <class Real>
void append_rows(Bytes& to, std::span<const double> positions,
                 std::span<const PointColumn> columns) {
    for (std::size_t point = 0; point < positions.size() / 3; ++point) {
        for (std::size_t axis = 0; axis < 3; ++axis)
            append_number(to, static_cast<Real>(positions[3 * point + axis]));
        for (const PointColumn& column : columns) {
            const std::size_t size = size_of(column.dtype);
            append(to, column.values.data() + size * point, size);
        }
    }
}

std::string_view ply_type(std::string_view dtype) {
    if (dtype == "|u1") return "uchar";
    if (dtype == "<u2") return "ushort";
    if (dtype == "<u4") return "uint";
    return dtype == "<f4" ? "float" : "double";
}

Bytes format_ply(std::span<const double> positions, std::span<const PointColumn> columns) {
    std::string head = "ply\nformat binary_little_endian 1.0\nelement vertex " +
                       std::to_string(positions.size() / 3) +
                       "\nproperty double x\nproperty double y\nproperty double z\n";
    for (const PointColumn& column : columns) {
        head += "property ";
        head += ply_type(column.dtype);
        head += " " + column.name + "\n";
    }
    Bytes file;
    append_text(file, head + "end_header\n");
    append_rows<double>(file, positions, columns);
    return file;
}

Bytes format_pcd(std::span<const double> positions, std::span<const PointColumn> columns) {
    // Many readers take float32 alone.
    const bool far =
        std::ranges::any_of(positions, [](double value) { return std::abs(value) > float32_most; });
    std::string names = "x y z";
    std::string sizes = far ? "8 8 8" : "4 4 4";
    std::string types = "F F F";
    std::string counts = "1 1 1";
    for (const PointColumn& column : columns) {
        names += " " + column.name;
        sizes += " " + std::to_string(size_of(column.dtype));
        types += column.dtype[1] == 'f' ? " F" : " U";
        counts += " 1";
    }
    const std::string count = std::to_string(positions.size() / 3);
    Bytes file;
    append_text(file, "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS " + names +
                          "\nSIZE " + sizes + "\nTYPE " + types + "\nCOUNT " + counts + "\nWIDTH " +
                          count + "\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS " + count +
                          "\nDATA binary\n");
    if (far)
        append_rows<double>(file, positions, columns);
    else
        append_rows<float>(file, positions, columns);
    return file;
}

int count_of(const PointColumn* column, std::size_t point, int otherwise) {
    if (column == nullptr) return otherwise;
    std::uint16_t value = 0;
    std::memcpy(&value, column->values.data() + sizeof value * point, sizeof value);
    return value;
}

/// LAS 1.2, point format 1, or with colours 3.
Result<Bytes> format_las(std::span<const double> positions, std::span<const PointColumn> columns) {
    const std::size_t count = positions.size() / 3;
    if (count > las_points_max)
        return fail(Exit::usage, "a .las holds 4,294,967,295 points: write a .ply or .pcd");
    const PointColumn* number = nullptr;
    const PointColumn* of_ray = nullptr;
    const PointColumn* time = nullptr;
    const PointColumn* ring = nullptr;
    const PointColumn* reflectance = nullptr;
    std::vector<const PointColumn*> colours;
    for (const PointColumn& column : columns) {
        if (column.name == "return" && column.dtype == "<u2")
            number = &column;
        else if (column.name == "returns" && column.dtype == "<u2")
            of_ray = &column;
        else if (column.name == "time" && column.dtype == "<f8")
            time = &column;
        else if (column.name == "ring" && column.dtype == "<u2")
            ring = &column;
        else if (column.name == "reflectance" && column.dtype == "<f4")
            reflectance = &column;
        else if (std::ranges::find(colour_names, column.name) != colour_names.end())
            colours.push_back(&column);
    }
    const std::size_t point_bytes = las_point_bytes + (colours.empty() ? 0 : las_colour_bytes);
    std::array<double, 3> low{}, high{}, scale{}, offset{};
    for (std::size_t axis = 0; axis < 3; ++axis) {
        if (count != 0) low[axis] = high[axis] = positions[axis];
        for (std::size_t point = 1; point < count; ++point) {
            low[axis] = std::min(low[axis], positions[3 * point + axis]);
            high[axis] = std::max(high[axis], positions[3 * point + axis]);
        }
        offset[axis] = std::floor(low[axis]);
        const double step = std::max(1e-9, (high[axis] - offset[axis]) / (1 << 30));
        scale[axis] = std::pow(10.0, std::ceil(std::log10(step)));
    }
    std::array<std::uint32_t, las_returns_max> by_return{};
    Bytes rows;
    rows.reserve(count * point_bytes);
    for (std::size_t point = 0; point < count; ++point) {
        for (std::size_t axis = 0; axis < 3; ++axis)
            append_number(rows, static_cast<std::int32_t>(std::nearbyint(
                                    (positions[3 * point + axis] - offset[axis]) / scale[axis])));
        const int which = count_of(number, point, 0) + 1;
        const int of = count_of(of_ray, point, 1);
        if (which > las_returns_max || of > las_returns_max)
            return fail(Exit::usage,
                        "a .las holds 5 hits of a ray: pass --max-hits 5, or write a "
                        ".ply or .pcd");
        ++by_return[static_cast<std::size_t>(which - 1)];
        float share = 0;
        if (reflectance != nullptr)
            std::memcpy(&share, reflectance->values.data() + sizeof share * point, sizeof share);
        append_number(rows, static_cast<std::uint16_t>(
                                std::nearbyint(65535 * double{std::clamp(share, 0.0F, 1.0F)})));
        append_number(rows, static_cast<std::uint8_t>(which | of << 3));
        rows.resize(rows.size() + 2);  // class and angle
        const int channel = count_of(ring, point, 0);
        if (channel > std::numeric_limits<std::uint8_t>::max())
            return fail(Exit::usage,
                        "a .las holds rings up to 255: write a .ply or .pcd, or leave ring out");
        append_number(rows, static_cast<std::uint8_t>(channel));
        append_number(rows, std::uint16_t{0});  // source
        double seconds = 0;
        if (time != nullptr)
            std::memcpy(&seconds, time->values.data() + sizeof seconds * point, sizeof seconds);
        append_number(rows, seconds);
        for (const PointColumn* shade : colours)
            append(rows, shade->values.data() + sizeof(std::uint16_t) * point,
                   sizeof(std::uint16_t));
    }
    Bytes file;
    append_text(file, "LASF");
    file.resize(24);
    append_number(file, std::uint8_t{1});
    append_number(file, std::uint8_t{2});
    for (int i = 0; i < 2; ++i) {
        append_text(file, "RayNest");
        file.resize(26 + 32 * static_cast<std::size_t>(i + 1));
    }
    file.resize(file.size() + 4);  // day and year
    append_number(file, std::uint16_t{227});
    append_number(file, std::uint32_t{227});
    append_number(file, std::uint32_t{0});
    append_number(file, static_cast<std::uint8_t>(colours.empty() ? 1 : 3));
    append_number(file, static_cast<std::uint16_t>(point_bytes));
    append_number(file, static_cast<std::uint32_t>(count));
    for (const std::uint32_t points : by_return) append_number(file, points);
    for (const double value : scale) append_number(file, value);
    for (const double value : offset) append_number(file, value);
    for (std::size_t axis = 0; axis < 3; ++axis) {
        append_number(file, high[axis]);
        append_number(file, low[axis]);
    }
    file.insert(file.end(), rows.begin(), rows.end());
    return file;
}

}  // namespace

Result<void> check_las_column(std::string_view name) {
    constexpr std::array known{"position", "return",      "returns",    "time",
                               "ring",     "reflectance", "base_colour"};
    if (std::ranges::find(known, name) != known.end()) return {};
    return fail(Exit::usage, "a .las has no room for the column '" + std::string(name) +
                                 "': write a .ply or .pcd, or pass --fields position");
}

std::string_view place_of(std::span<const std::string> columns) {
    for (const std::string_view place : {"position", "sensor_position"})
        if (std::ranges::find(columns, place) != columns.end()) return place;
    return "";
}

bool is_point_ending(std::string_view ending) {
    return std::ranges::find(point_endings, ending) != point_endings.end();
}

Result<Bytes> format_points(std::string_view ending, std::span<const double> positions,
                            std::span<const PointColumn> columns) {
    if (ending == ".las")
        for (const PointColumn& column : columns)
            if (auto fits = check_las_column(column.name); !fits)
                return tl::unexpected<Failure>(fits.error());
    const std::vector<PointColumn> plain = columns_of_one(ending, columns);
    if (ending == ".las") return format_las(positions, plain);
    return ending == ".pcd" ? format_pcd(positions, plain) : format_ply(positions, plain);
}

}  // namespace raynest::client
