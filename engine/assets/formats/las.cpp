// LAS points. Debian 12 has no LASzip and no PDAL, so compressed files (LAZ) are refused.
#include "engine/assets/formats/formats.h"
#include "engine/assets/formats/number_at.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>

namespace raynest {
namespace {

constexpr std::size_t header_bytes_min = 227;  ///< the header of LAS 1.0 to 1.2
constexpr std::size_t header_bytes_14 = 375;
constexpr std::size_t format_count = 11;
/// The least bytes of a point in each format; more are a file's own.
constexpr std::array<std::uint16_t, format_count> point_bytes{20, 28, 26, 34, 57, 63,
                                                              30, 36, 38, 59, 67};

tl::unexpected<Error> refuse_laz() {
    return fail(
        ErrorCode::scene_unsupported,
        "is compressed (LAZ), which is not read: unpack it with laszip -i in.laz -o out.las, or "
        "with pdal translate in.laz out.las");
}

/// Returns RGBA of the points, or nothing where the format has no colours or all are black, as
/// programs write that have none. Colours have 16 bits; files in which all are below 256 have 8.
std::vector<std::uint8_t> read_colours(std::span<const std::byte> points, std::uint8_t format,
                                       std::uint16_t record_bytes, std::uint64_t count,
                                       FileContent& content) {
    constexpr std::size_t none = 0;
    constexpr std::array<std::size_t, format_count> places{none, none, 20, 28,   none, 28,
                                                           none, 30,   30, none, 30};
    const std::size_t place = places[format];
    if (place == none) return {};
    const auto channel = [&](std::uint64_t point, std::size_t i) {
        return number_at<std::uint16_t>(points, point * record_bytes + place + 2 * i);
    };
    std::uint16_t most = 0;
    for (std::uint64_t point = 0; point < count; ++point)
        for (std::size_t i = 0; i < 3; ++i) most = std::max(most, channel(point, i));
    if (most == 0) return {};
    const bool is_short = most < 256;
    if (is_short)
        content.warnings.emplace_back("no colour is above 255: they are taken to have 8 bits");
    std::vector<std::uint8_t> rgba(4 * count, 255);
    for (std::uint64_t point = 0; point < count; ++point)
        for (std::size_t i = 0; i < 3; ++i)
            rgba[4 * point + i] =
                static_cast<std::uint8_t>(channel(point, i) >> (is_short ? 0U : 8U));
    return rgba;
}

}  // namespace

Result<FileContent> read_laz(const ImportRequest&, const ImportLimits&) {
    return refuse_laz();
}

Result<FileContent> read_las(const ImportRequest& request, const ImportLimits& limits) {
    const std::span<const std::byte> file = request.files.front().bytes;
    if (file.size() < header_bytes_min || std::memcmp(file.data(), "LASF", 4) != 0)
        return fail(ErrorCode::scene_invalid, "is no LAS file, or is cut short within its header");
    const auto major = number_at<std::uint8_t>(file, 24);
    const auto minor = number_at<std::uint8_t>(file, 25);
    const auto format = number_at<std::uint8_t>(file, 104);
    if (major != 1 || minor > 4)
        return fail(ErrorCode::scene_unsupported,
                    fmt::format("is LAS {}.{}; 1.0 to 1.4 are read", major, minor));
    if ((format & 0x80) != 0) return refuse_laz();
    const auto data_at = number_at<std::uint32_t>(file, 96);
    const auto record_bytes = number_at<std::uint16_t>(file, 105);
    std::uint64_t count = number_at<std::uint32_t>(file, 107);
    // Some programs fill in the older count alone.
    if (minor == 4 && file.size() >= header_bytes_14)
        if (const auto wide = number_at<std::uint64_t>(file, 247); wide != 0) count = wide;
    if (format >= format_count)
        return fail(ErrorCode::scene_unsupported,
                    fmt::format("has points of format {}; 0 to 10 are read", format));
    if (record_bytes < point_bytes[format] || data_at < header_bytes_min || data_at > file.size())
        return fail(ErrorCode::scene_invalid,
                    "has a damaged header: its points lie outside the file or are too short");
    const std::uint64_t there = (file.size() - data_at) / record_bytes;
    if (count > there)
        return fail(
            ErrorCode::scene_invalid,
            fmt::format("says that it has {} points, and has {}: it is cut short", count, there));
    if (count > limits.triangles_max)
        return fail(ErrorCode::limit_exceeded, fmt::format("has {} points; at most {} are allowed",
                                                           count, limits.triangles_max));
    std::array<double, 6> scale_offset{};  // for x, y, z each
    std::memcpy(scale_offset.data(), file.data() + 131, sizeof scale_offset);
    for (std::size_t i = 0; i < scale_offset.size(); ++i)
        if (!std::isfinite(scale_offset[i]) || (i < 3 && scale_offset[i] == 0))
            return fail(
                ErrorCode::scene_invalid,
                "has a damaged header: a scale is 0, or a scale or an offset is not finite");
    FileContent content;
    content.points.reserve(count);
    content.point_colours =
        read_colours(file.subspan(data_at), format, record_bytes, count, content);
    for (std::uint64_t i = 0; i < count; ++i) {
        const std::size_t at = data_at + i * record_bytes;
        glm::dvec3 point;
        for (int axis = 0; axis < 3; ++axis)
            point[axis] = number_at<std::int32_t>(file, at + 4 * static_cast<std::size_t>(axis)) *
                              scale_offset[static_cast<std::size_t>(axis)] +
                          scale_offset[static_cast<std::size_t>(axis) + 3];
        content.points.push_back(point);
    }
    return content;
}

}  // namespace raynest
