#include "client/requests/rays.h"

#include "client/files/files.h"
#include "client/ground/text.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <sstream>
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

/// The shape of an array as rows of one of these widths: one row may lack its brackets, and there
/// may be none. Nothing for any other shape.
std::optional<std::vector<std::uint64_t>> rows_of(std::vector<std::uint64_t> shape,
                                                  std::initializer_list<std::uint64_t> widths) {
    if (shape == std::vector<std::uint64_t>{0}) shape.push_back(*widths.begin());
    if (shape.size() == 1) shape.insert(shape.begin(), 1);
    if (shape.size() != 2 || std::ranges::find(widths, shape[1]) == widths.end())
        return std::nullopt;
    return shape;
}

/// How far float32 moves a point, less the scene's origin.
double moved_by_rounding(const WorldPoint& point, const WorldPoint& origin) {
    WorldPoint off{};
    for (std::size_t i = 0; i < 3; ++i) {
        const double exact = point[i] - origin[i];
        off[i] = double{static_cast<float>(exact)} - exact;
    }
    return std::hypot(off[0], off[1], off[2]);
}

/// Half a step between float32 numbers as large as the largest coordinate: so far from a point may
/// lie what it was rounded from.
double half_step(const WorldPoint& point) {
    const double farthest = std::max({std::abs(point[0]), std::abs(point[1]), std::abs(point[2])});
    const auto from = static_cast<float>(farthest);
    const float next = std::nextafter(from, std::numeric_limits<float>::infinity());
    return (double{next} - double{from}) / 2;
}

/// A share of the scene's size from which on a distance is worth a warning.
constexpr double notable_share = 1e-4;

/// "500000,4500000,0": of few digits, near the centre of the scene.
std::string near_scene(const SceneOrigin& scene) {
    const double step = std::pow(10.0, std::ceil(std::log10(scene.size)));
    std::ostringstream text;
    text.precision(15);
    for (const double x : scene.centre)
        text << (text.tellp() == 0 ? "" : ",") << std::round(x / step) * step + 0.0;
    return text.str();
}

}  // namespace

RaySource::RaySource(const std::vector<WorldRay>& rays, const WorldPoint& scene_origin)
    : count_(rays.size()),
      scene_origin_(scene_origin) {
    values_.reserve(rays.size() * width_);
    for (const WorldRay& ray : rays) {
        for (std::size_t i = 0; i < ray.size(); ++i)
            values_.push_back(static_cast<float>(ray[i] - (i < 3 ? scene_origin[i] : 0)));
        moved_.push_back(moved_by_rounding({ray[0], ray[1], ray[2]}, scene_origin));
    }
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
    if (source) source->moved_ = {moved_by_rounding(*from, scene_origin)};
    return source;
}

Result<RaySource> RaySource::open_points(const std::string& path, const WorldPoint& scene_origin) {
    return open(path, scene_origin, {6, 8}, "points and normals have the shape (N, 6)");
}

Result<RaySource> RaySource::open(const std::string& path, const WorldPoint& scene_origin,
                                  std::initializer_list<std::uint64_t> widths,
                                  const std::string& shapes) {
    const auto blame = [&](const std::string& why) {
        return fail(Exit::invalid, shown_name(path) + " " + why);
    };
    // An endless pipe is refused by its first bytes.
    const auto check =
        [&](std::span<const std::byte> begin) -> Result<std::optional<std::uint64_t>> {
        const auto header = read_npy_header(begin);
        if (!header) return blame(header.error().message);
        if (!*header) return std::nullopt;
        if (!rows_of((*header)->array.shape, widths))
            return blame("has the shape " + shape_text((*header)->array.shape) + "; " + shapes);
        if ((*header)->bytes > piped_bytes_max - (*header)->begin)
            return blame("announces " + std::to_string((*header)->bytes) +
                         " bytes; of a pipe at most " + std::to_string(piped_bytes_max) +
                         " are taken");
        return (*header)->begin + (*header)->bytes;
    };
    auto file = read_file(path, rays_file_bytes_max, check);
    if (!file) return tl::unexpected<Failure>(file.error());
    auto array = parse_npy(std::as_const(*file).span());
    if (!array) return blame(array.error().message);
    const auto rows = rows_of(array->shape, widths);
    if (!rows) return blame("has the shape " + shape_text(array->shape) + "; " + shapes);
    array->shape = *rows;
    RaySource source;
    source.scene_origin_ = scene_origin;
    source.file_ = std::move(*file);
    source.array_ = std::move(*array);
    source.count_ = source.array_.shape[0];
    source.width_ = static_cast<std::uint32_t>(source.array_.shape[1]);
    return source;
}

Result<void> RaySource::open_masks(const std::string& path) {
    const auto blame = [&](const std::string& why) {
        return fail(Exit::invalid, shown_name(path) + " " + why);
    };
    constexpr std::uint64_t header_bytes_max = 128ULL << 10;
    auto file = read_file(path, count_ * sizeof(std::uint64_t) + header_bytes_max);
    if (!file) return tl::unexpected<Failure>(file.error());
    auto array = parse_npy(std::as_const(*file).span());
    if (!array) return blame(array.error().message);
    if (array->shape != std::vector<std::uint64_t>{count_})
        return blame("has the shape " + shape_text(array->shape) +
                     "; masks of these rays have the shape (" + std::to_string(count_) + ",)");
    if (array->dtype[1] == 'f')
        return blame("has floats (" + array->dtype +
                     "); masks are whole numbers: save them as astype(numpy.uint32)");
    array->shape.push_back(1);
    masks_.reserve(count_);
    for (std::uint64_t i = 0; i < count_; ++i) {
        const double mask = value_at(*array, i, 0);
        constexpr double most = std::numeric_limits<std::uint32_t>::max();
        if (mask < 0 || mask > most) {
            std::ostringstream why;
            why.precision(12);
            why << "has " << mask << " as the mask of ray " << i
                << "; masks are whole numbers from 0 to 4294967295";
            return blame(why.str());
        }
        masks_.push_back(static_cast<std::uint32_t>(mask));
    }
    return {};
}

void RaySource::keep(const PartRange& range) {
    if (!masks_.empty()) {
        masks_.erase(masks_.begin(), masks_.begin() + static_cast<std::ptrdiff_t>(range.first));
        masks_.resize(range.count);
    }
    first_ += range.first;
    count_ = range.count;
}

std::span<const std::byte> RaySource::bytes(std::uint64_t first, std::uint64_t count) const {
    first += first_;
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
    read_rows(array_, first_ + first, out,
              subtracts() ? std::span<const double>(scene_origin_) : std::span<const double>());
}

double RaySource::moved(std::uint64_t ray) const {
    ray += first_;
    if (!moved_.empty()) return moved_[std::min<std::uint64_t>(ray, moved_.size() - 1)];
    const WorldPoint start{value_at(array_, ray, 0), value_at(array_, ray, 1),
                           value_at(array_, ray, 2)};
    return is_float32() ? half_step(start) : moved_by_rounding(start, scene_origin_);
}

RaySource::Rounding RaySource::rounding(double notable) const {
    Rounding lost;
    for (std::uint64_t ray = 0; ray < count_; ++ray) {
        const double by = moved(ray);
        if (!std::isfinite(by) || by <= notable) continue;
        if (lost.count++ == 0) lost.first = ray;
        lost.farthest = std::max(lost.farthest, by);
    }
    return lost;
}

bool RaySource::is_float32() const {
    return moved_.empty() && array_.dtype.ends_with("f4");
}

bool RaySource::subtracts() const {
    return width_ != 3 && scene_origin_ != WorldPoint{};
}

std::string rounding_warning(const RaySource& rays, const SceneOrigin& scene,
                             std::string_view subject) {
    const double notable = notable_share * scene.size;
    if (!(notable > 0)) return {};
    const auto& [x, y, z] = scene.centre;
    const bool is_far =
        half_step({x - scene.point[0], y - scene.point[1], z - scene.point[2]}) > notable;
    // Around a scene at its origin float32 rays are what their file says: nothing is lost here.
    if (rays.is_float32() && !is_far && scene.point == WorldPoint{}) return {};
    const RaySource::Rounding lost = rays.rounding(notable);
    if (lost.count == 0) return {};
    std::ostringstream text;
    text.precision(3);
    if (subject.empty())
        text << grouped(lost.count) << " of " << grouped(rays.count())
             << (rays.count() == 1 ? " ray starts" : " rays start");
    text << subject << " so far from the scene's origin that float32 moves "
         << (lost.count == 1 ? "it" : "them") << " by up to " << lost.farthest
         << ", and the scene's size is " << scene.size;
    if (subject.empty()) text << "; the first is ray " << lost.first;
    text << ". To keep " << (subject.empty() ? "their" : "its") << " digits ";
    if (is_far) text << "load the scene with --origin " << near_scene(scene);
    if (is_far && rays.is_float32()) text << " and ";
    if (rays.is_float32()) text << "save the rays as float64";
    if (!is_far && !rays.is_float32())
        text << (subject.empty() ? "start them" : "place it") << " nearer to the scene";
    return text.str();
}

}  // namespace raynest::client
