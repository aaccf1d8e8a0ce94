#include "client/output/columns.h"

#include "client/files/npy.h"
#include "client/files/points.h"
#include "client/ground/lists.h"
#include "client/ground/numbers.h"
#include "client/requests/generator.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <limits>
#include <span>

namespace raynest::client {
namespace {

std::string numpy_dtype(wire::Dtype dtype) {
    switch (dtype) {
        case wire::Dtype::u8:
            return "|u1";
        case wire::Dtype::u32:
            return "<u4";
        case wire::Dtype::u64:
            return "<u8";
        case wire::Dtype::f32:
            return "<f4";
    }
    return "|u1";
}

/// Makes numbers of 64 bits those of 32.
Result<void> shorten(PointColumn& column) {
    std::vector<std::byte> values(column.values.size() / 2);
    for (std::size_t i = 0; i < values.size() / 4; ++i) {
        std::uint64_t value = 0;
        std::memcpy(&value, column.values.data() + 8 * i, 8);
        if (value > std::numeric_limits<std::uint32_t>::max())
            return fail(Exit::usage, "the column '" + column.name +
                                         "' has numbers beyond 32 bits, "
                                         "which these files cannot hold: leave it out of --fields");
        const auto narrow = static_cast<std::uint32_t>(value);
        std::memcpy(values.data() + 4 * i, &narrow, 4);
    }
    column.values = std::move(values);
    column.dtype = "<u4";
    return {};
}

}  // namespace

Result<void> Columns::append(const QueryChunk& chunk) {
    for (const protocol::BlockView& block : chunk.columns) {
        const auto [at, is_new] = columns_.try_emplace(std::string(block.name));
        Column& column = at->second;
        if (is_new) {
            order_.push_back(at->first);
            column.dtype = block.dtype, column.width = block.width();
            column.shown = chunk.shows(block.name);
            column.is_world =
                is_point_field(block.name) && block.dtype == wire::Dtype::f32 && block.width() == 3;
            column.numpy = column.is_world || is_time(block) ? "<f8"
                           : is_ring(block)                  ? "<u2"
                                                             : numpy_dtype(block.dtype);
            column.value_bytes = static_cast<std::size_t>(column.numpy[2] - '0');
        }
        if (column.dtype != block.dtype || column.width != block.width())
            return daemon_sent("a column of another type than in the chunk before");
        if (column.is_world)
            append_points(chunk, block, column);
        else if (is_ring(block))
            for (const std::uint64_t ring : block.values<std::uint64_t>()) {
                const auto narrow = static_cast<std::uint16_t>(ring);  // sweep_channels_max is less
                const auto bytes = std::as_bytes(std::span(&narrow, 1));
                column.bytes.insert(column.bytes.end(), bytes.begin(), bytes.end());
            }
        else
            column.bytes.insert(column.bytes.end(), block.bytes.begin(), block.bytes.end());
        column.count += block.count;
    }
    for (std::uint32_t i = 0; i < chunk.count; ++i)
        splits_.push_back(splits_.back() + chunk.splits[i + 1] - chunk.splits[i]);
    return {};
}

/// Appends points in the world; the position of a miss stays 0.
void Columns::append_points(const QueryChunk& chunk, const protocol::BlockView& block,
                            Column& column) {
    const protocol::BlockView* hit = protocol::find_block(chunk.columns, "hit");
    const bool tells = hit != nullptr && hit->count == block.count && block.name == "position" &&
                       hit->dtype == wire::Dtype::u8;
    const std::span<const float> points = block.values<float>();
    for (std::uint64_t i = 0; i < 3 * block.count; ++i) {
        const bool missed = tells && hit->bytes[i / 3] == std::byte{0};
        const double value = double{points[i]} + (missed ? 0 : chunk.origin[i % 3]);
        const auto bytes = std::as_bytes(std::span(&value, 1));
        column.bytes.insert(column.bytes.end(), bytes.begin(), bytes.end());
    }
}

void Columns::complete(std::string_view reducer) {
    const ReducerWords* const words = find_reducer(reducer);
    if (words == nullptr) return;
    for (const std::string& each : split(words->columns, ',')) {
        const std::vector<std::string> word = split(each, ' ');
        Column column;
        column.numpy = word.back() == "u64" ? "<u8" : word.back() == "u32" ? "<u4" : "<f4";
        columns_.try_emplace(word.front(), column);
    }
}

std::vector<std::byte> Columns::npz(std::string_view part) const {
    std::vector<NamedArray> arrays;
    if (!part.empty())
        arrays.push_back({"part", {"|u1", {part.size()}, std::as_bytes(std::span(part))}});
    if (has_splits_)
        arrays.push_back(
            {"ray_splits", {"<i8", {splits_.size()}, std::as_bytes(std::span(splits_))}});
    for (const auto& [name, column] : columns_) {
        // A part tells hits from misses, for those that make points of it.
        if (!column.shown && part.empty()) continue;
        std::vector<std::uint64_t> shape = {column.count};
        if (column.width > 1) shape.push_back(column.width);
        const bool is_truth = column.dtype == wire::Dtype::u8 && is_truth_field(name);
        const std::string dtype = is_truth ? "|b1" : column.numpy;
        arrays.push_back({name, {dtype, shape, column.bytes}});
    }
    return format_npz(arrays);
}

std::vector<std::uint64_t> Columns::hit_rows() const {
    std::vector<std::uint64_t> rows;
    const auto place = columns_.find(std::string(place_of(order_)));
    if (place == columns_.end()) return rows;
    const auto hit = columns_.find("hit");
    for (std::uint64_t row = 0; row < place->second.count; ++row) {
        if (has_splits_ || hit == columns_.end() || hit->second.bytes[row] != std::byte{0})
            rows.push_back(row);
    }
    return rows;
}

Result<std::vector<std::byte>> Columns::points(std::string_view ending) const {
    if (place_of(order_).empty() || (!has_splits_ && !columns_.contains("hit")))
        return fail(Exit::usage,
                    "the answer is no point cloud: the query needs the columns position, or "
                    "sensor_position, and hit among its --fields; write a .npz");
    const std::vector<std::uint64_t> hits = hit_rows();
    std::vector<std::uint64_t> rays;  // each hit's ray, where a ray may have several
    for (std::uint64_t ray = 0; has_splits_ && ray + 1 < splits_.size(); ++ray)
        rays.insert(rays.end(), splits_[ray + 1] - splits_[ray], ray);
    const std::string_view place = place_of(order_);
    std::vector<double> positions(3 * hits.size());
    std::vector<PointColumn> beside;
    for (const std::string& name : order_) {
        const Column& column = columns_.find(name)->second;
        if (!column.shown) continue;
        const std::vector<std::uint64_t>& rows = has_splits_ && !is_hit_field(name) ? rays : hits;
        if (name == place) {
            for (std::size_t i = 0; i < rows.size(); ++i) {
                const std::byte* const from =
                    column.bytes.data() + 3 * column.value_bytes * rows[i];
                std::array<float, 3> of_sensor{};
                if (column.value_bytes == sizeof(double)) {
                    std::memcpy(&positions[3 * i], from, 3 * sizeof(double));
                } else {
                    std::memcpy(of_sensor.data(), from, sizeof(of_sensor));
                    std::ranges::copy(of_sensor,
                                      positions.begin() + static_cast<std::ptrdiff_t>(3 * i));
                }
            }
            continue;
        }
        const std::size_t size = column.value_bytes * column.width;
        PointColumn made{name, column.numpy, std::vector<std::byte>(size * rows.size()),
                         column.width};
        for (std::size_t i = 0; i < rows.size(); ++i)
            std::memcpy(made.values.data() + size * i, column.bytes.data() + size * rows[i], size);
        if (made.dtype == "<u8") {
            if (auto fits = shorten(made); !fits) return tl::unexpected<Failure>(fits.error());
        }
        beside.push_back(std::move(made));
    }
    if (has_splits_) {
        PointColumn number{"return", "<u2", {}};
        PointColumn of_ray{"returns", "<u2", {}};
        for (const std::uint64_t hit : hits) {
            const std::uint64_t ray = rays[hit];
            const std::uint16_t counts[2] = {
                static_cast<std::uint16_t>(hit - splits_[ray]),
                static_cast<std::uint16_t>(splits_[ray + 1] - splits_[ray])};
            const auto bytes = std::as_bytes(std::span(counts));
            number.values.insert(number.values.end(), bytes.begin(), bytes.begin() + 2);
            of_ray.values.insert(of_ray.values.end(), bytes.begin() + 2, bytes.end());
        }
        beside.push_back(std::move(number));
        beside.push_back(std::move(of_ray));
    }
    return format_points(ending, positions, beside);
}

}  // namespace raynest::client
