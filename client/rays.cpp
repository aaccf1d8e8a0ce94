#include "client/rays.h"

#include "client/files.h"

#include <algorithm>
#include <cstring>
#include <limits>
#include <utility>

namespace raynest::client {
namespace {

constexpr std::uint64_t rays_file_bytes_max = 1ULL << 40;

template <class Number>
Ray read_row(const std::byte* row, std::size_t columns) {
    Number values[8];
    std::memcpy(values, row, columns * sizeof(Number));
    const auto at = [&](std::size_t i) { return static_cast<float>(values[i]); };
    if (columns == 8) return {at(0), at(1), at(2), at(3), at(4), at(5), at(6), at(7)};
    return {at(0), at(1), at(2), 0, at(3), at(4), at(5), std::numeric_limits<float>::infinity()};
}

}  // namespace

RaySource::RaySource(std::vector<Ray> rays) : rays_(std::move(rays)), count_(rays_.size()) {}

Result<RaySource> RaySource::open(const std::string& path) {
    auto file = read_file(path, rays_file_bytes_max);
    if (!file) return tl::unexpected<Failure>(file.error());
    auto array = parse_npy(std::as_const(*file).span());
    if (!array) return fail(Exit::invalid, path + " " + array.error().message);
    const bool shaped = array->shape.size() == 2 && (array->shape[1] == 6 || array->shape[1] == 8);
    if (!shaped || (array->dtype != "<f4" && array->dtype != "<f8"))
        return fail(Exit::invalid,
                    path + " must hold float32 or float64 of shape (N, 6) or (N, 8)");
    if (array->shape[0] == 0) return fail(Exit::invalid, path + " holds no rays");
    RaySource source;
    source.file_ = std::move(*file);
    source.array_ = std::move(*array);
    source.count_ = source.array_.shape[0];
    return source;
}

std::span<const std::byte> RaySource::bytes(std::uint64_t first, std::uint64_t count) const {
    if (!rays_.empty()) return std::as_bytes(std::span(rays_).subspan(first, count));
    if (array_.dtype != "<f4" || array_.shape[1] != 8) return {};
    return array_.bytes.subspan(first * sizeof(Ray), count * sizeof(Ray));
}

void RaySource::read(std::uint64_t first, std::span<Ray> out) const {
    if (const auto ready = bytes(first, out.size()); !ready.empty()) {
        std::memcpy(out.data(), ready.data(), ready.size());
        return;
    }
    const std::size_t columns = array_.shape[1];
    const bool doubles = array_.dtype == "<f8";
    const std::size_t row_bytes = columns * (doubles ? sizeof(double) : sizeof(float));
    const std::byte* row = array_.bytes.data() + first * row_bytes;
    for (Ray& ray : out) {
        ray = doubles ? read_row<double>(row, columns) : read_row<float>(row, columns);
        row += row_bytes;
    }
}

}  // namespace raynest::client
