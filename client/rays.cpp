#include "client/rays.h"

#include "client/files.h"
#include "client/scene_origin.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <utility>

namespace raynest::client {
namespace {

constexpr std::uint64_t rays_file_bytes_max = 1ULL << 40;

/// "(3, 8)", "(6,)".
std::string shape_text(const std::vector<std::uint64_t>& shape) {
    std::string text = "(";
    for (const std::uint64_t size : shape) text += (text == "(" ? "" : ", ") + std::to_string(size);
    return text + (shape.size() == 1 ? ",)" : ")");
}

}  // namespace

RaySource::RaySource(const std::vector<WorldRay>& rays, const WorldPoint& scene_origin)
    : count_(rays.size()),
      scene_origin_(scene_origin) {
    values_.reserve(rays.size() * width_);
    for (const WorldRay& ray : rays)
        for (std::size_t i = 0; i < ray.size(); ++i)
            values_.push_back(static_cast<float>(ray[i] - (i < 3 ? scene_origin[i] : 0)));
}

RaySource::RaySource(std::vector<float> values, std::uint32_t width,
                     const std::optional<wire::Vec3>& common_origin)
    : values_(std::move(values)),
      count_(values_.size() / width),
      width_(width),
      common_origin_(common_origin) {}

Result<RaySource> RaySource::open(const std::string& path, const std::optional<WorldPoint>& from,
                                  const WorldPoint& scene_origin) {
    if (!from)
        return open(path, scene_origin, {6, 8},
                    "rays have the shape (N, 6) or (N, 8), or (N, 3) with --from");
    auto source =
        open(path, scene_origin, {3}, "rays have the shape (N, 3): directions from that point");
    if (source) source->common_origin_ = less_origin(*from, scene_origin);
    return source;
}

Result<RaySource> RaySource::open_points(const std::string& path, const WorldPoint& scene_origin) {
    return open(path, scene_origin, {6, 8}, "points and normals have the shape (N, 6)");
}

Result<RaySource> RaySource::open(const std::string& path, const WorldPoint& scene_origin,
                                  std::initializer_list<std::uint64_t> widths,
                                  const std::string& shapes) {
    auto file = read_file(path, rays_file_bytes_max);
    if (!file) return tl::unexpected<Failure>(file.error());
    auto array = parse_npy(std::as_const(*file).span());
    if (!array) return fail(Exit::invalid, shown_name(path) + " " + array.error().message);
    const std::vector<std::uint64_t> given = array->shape;
    std::vector<std::uint64_t>& shape = array->shape;
    if (shape == std::vector<std::uint64_t>{0}) shape.push_back(*widths.begin());
    if (shape.size() == 1) shape.insert(shape.begin(), 1);
    if (shape.size() != 2 || std::ranges::find(widths, shape[1]) == widths.end())
        return fail(Exit::invalid,
                    shown_name(path) + " has the shape " + shape_text(given) + "; " + shapes);
    RaySource source;
    source.scene_origin_ = scene_origin;
    source.file_ = std::move(*file);
    source.array_ = std::move(*array);
    source.count_ = source.array_.shape[0];
    source.width_ = static_cast<std::uint32_t>(source.array_.shape[1]);
    return source;
}

std::span<const std::byte> RaySource::bytes(std::uint64_t first, std::uint64_t count) const {
    if (!values_.empty())
        return std::as_bytes(std::span(values_).subspan(first * width_, count * width_));
    if (!has_float_rows(array_) || subtracts()) return {};
    return array_.bytes.subspan(first * ray_bytes(), count * ray_bytes());
}

void RaySource::read(std::uint64_t first, std::span<float> out) const {
    if (const auto ready = bytes(first, out.size() / width_); !ready.empty()) {
        std::memcpy(out.data(), ready.data(), ready.size());
        return;
    }
    read_rows(array_, first, out,
              subtracts() ? std::span<const double>(scene_origin_) : std::span<const double>());
}

double RaySource::rounding() const {
    if (!subtracts() || array_.dtype.size() < 3 || array_.dtype.substr(1) != "f4") return 0;
    constexpr std::uint64_t at_once = 4096;
    std::vector<float> rows(at_once * width_);
    float farthest = 0;
    for (std::uint64_t first = 0; first < count_; first += at_once) {
        const std::uint64_t rays = std::min(at_once, count_ - first);
        read_rows(array_, first, std::span(rows).first(rays * width_), {});
        for (std::uint64_t i = 0; i < rays * width_; ++i)
            if (i % width_ < 3 && std::isfinite(rows[i]))
                farthest = std::max(farthest, std::abs(rows[i]));
    }
    const float next = std::nextafter(farthest, std::numeric_limits<float>::infinity());
    return (double{next} - double{farthest}) / 2;
}

bool RaySource::subtracts() const {
    return width_ != 3 && scene_origin_ != WorldPoint{};
}

}  // namespace raynest::client
