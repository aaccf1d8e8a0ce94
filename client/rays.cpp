#include "client/rays.h"

#include "client/files.h"

#include <algorithm>
#include <cstring>
#include <utility>

namespace raynest::client {
namespace {

constexpr std::uint64_t rays_file_bytes_max = 1ULL << 40;

}  // namespace

RaySource::RaySource(const std::vector<Ray>& rays) : count_(rays.size()) {
    values_.reserve(rays.size() * width_);
    for (const Ray& ray : rays) values_.insert(values_.end(), ray.begin(), ray.end());
}

RaySource::RaySource(std::vector<float> values, std::uint32_t width,
                     const std::optional<Point>& origin)
    : values_(std::move(values)),
      count_(values_.size() / width),
      width_(width),
      origin_(origin) {}

Result<RaySource> RaySource::open(const std::string& path, const std::optional<Point>& origin) {
    if (!origin) return open(path, {6, 8}, "(N, 6) or (N, 8), or (N, 3) with --origin");
    auto source = open(path, {3}, "(N, 3): directions from that origin");
    if (source) source->origin_ = origin;
    return source;
}

Result<RaySource> RaySource::open_points(const std::string& path) {
    return open(path, {6, 8}, "(N, 6) or (N, 8)");
}

Result<RaySource> RaySource::open(const std::string& path,
                                  std::initializer_list<std::uint64_t> widths,
                                  const std::string& shapes) {
    auto file = read_file(path, rays_file_bytes_max);
    if (!file) return tl::unexpected<Failure>(file.error());
    auto array = parse_npy(std::as_const(*file).span());
    if (!array) return fail(Exit::invalid, path + " " + array.error().message);
    const bool shaped =
        array->shape.size() == 2 && std::ranges::find(widths, array->shape[1]) != widths.end();
    if (!shaped || (array->dtype != "<f4" && array->dtype != "<f8"))
        return fail(Exit::invalid, path + " must hold float32 or float64 of shape " + shapes);
    if (array->shape[0] == 0) return fail(Exit::invalid, path + " holds no rays");
    RaySource source;
    source.file_ = std::move(*file);
    source.array_ = std::move(*array);
    source.count_ = source.array_.shape[0];
    source.width_ = static_cast<std::uint32_t>(source.array_.shape[1]);
    return source;
}

std::span<const std::byte> RaySource::bytes(std::uint64_t first, std::uint64_t count) const {
    if (!values_.empty())
        return std::as_bytes(std::span(values_).subspan(first * width_, count * width_));
    if (array_.dtype != "<f4") return {};
    return array_.bytes.subspan(first * ray_bytes(), count * ray_bytes());
}

void RaySource::read(std::uint64_t first, std::span<float> out) const {
    if (const auto ready = bytes(first, out.size() / width_); !ready.empty()) {
        std::memcpy(out.data(), ready.data(), ready.size());
        return;
    }
    const std::byte* value = array_.bytes.data() + first * width_ * sizeof(double);
    for (float& rounded : out) {
        double exact;
        std::memcpy(&exact, value, sizeof exact);
        rounded = static_cast<float>(exact);
        value += sizeof exact;
    }
}

}  // namespace raynest::client
