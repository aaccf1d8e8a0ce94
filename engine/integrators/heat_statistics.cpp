// Exact statistics of a heat map and the range its colours span.
#include "engine/integrators/palette.h"
#include "engine/integrators/picture.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <string>
#include <vector>

namespace raynest {
namespace {

/// Counts are u32; a range beyond them would only flatten the picture.
constexpr double range_max = 4294967295.0;

tl::unexpected<Error> invalid(std::string message) {
    return fail(ErrorCode::param_invalid, std::move(message));
}

Result<void> check_options(const HeatOptions& options) {
    const auto column = parse_column(options.metric);
    const bool of_level = options.metric.find('.') != std::string::npos;
    if (!column && of_level && parse_field(options.metric.substr(0, options.metric.find('.'))))
        return tl::unexpected(column.error());
    if (!column || !field_info(column->field).counter) {
        std::string known;
        for (const FieldInfo& counter : counter_table())
            known += (known.empty() ? "" : ", ") + std::string(counter.name);
        return invalid("there is no metric '" + options.metric + "'; known: " + known);
    }
    if (options.scale != "linear" && options.scale != "log") {
        return invalid("there is no scale '" + options.scale + "'; known: linear, log");
    }
    if (auto palette = find_palette(options.palette); !palette) {
        return tl::unexpected(palette.error());
    }
    return {};
}

/// The smallest count that at least `percent` of all pixels do not exceed (nearest rank).
std::uint32_t percentile(std::vector<std::uint32_t>& counts, std::uint64_t percent) {
    const std::uint64_t rank = (counts.size() * percent + 99) / 100;
    const auto at =
        counts.begin() + static_cast<std::ptrdiff_t>(std::max<std::uint64_t>(rank, 1) - 1);
    std::nth_element(counts.begin(), at, counts.end());
    return *at;
}

struct Range {
    double low;
    double high;
};

Result<Range> parse_range(const HeatOptions& options, const HeatStatistics& statistics) {
    // A map of zeros still needs a range with a width.
    const auto up_to = [](std::uint32_t high) {
        return Range{0, std::max(1.0, static_cast<double>(high))};
    };
    if (options.range == "auto") return up_to(statistics.max);
    if (options.range == "p99") return up_to(statistics.p99);

    const auto parse = [](std::string_view text, double& value) {
        const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
        return error == std::errc{} && end == text.data() + text.size() && std::isfinite(value);
    };
    const std::string_view text = options.range;
    const std::size_t colon = text.find(':');
    Range range{0, 0};
    if (colon == std::string_view::npos || !parse(text.substr(0, colon), range.low) ||
        !parse(text.substr(colon + 1), range.high) || !(range.low >= 0) ||
        !(range.low < range.high) || !(range.high <= range_max)) {
        return invalid("the range '" + options.range +
                       "' is none of auto, p99 and low:high with 0 <= low < high <= 4294967295");
    }
    return range;
}

}  // namespace

Result<HeatStatistics> heat_statistics(std::span<const std::uint32_t> counts,
                                       const HeatOptions& options) {
    if (auto checked = check_options(options); !checked) return tl::unexpected(checked.error());
    HeatStatistics statistics;
    statistics.rays = counts.size();
    if (!counts.empty()) {
        std::vector<std::uint32_t> sorted(counts.begin(), counts.end());
        statistics.p50 = percentile(sorted, 50);
        statistics.p90 = percentile(sorted, 90);
        statistics.p99 = percentile(sorted, 99);
        const auto [least, most] = std::minmax_element(counts.begin(), counts.end());
        statistics.min = *least;
        statistics.max = *most;
        std::uint64_t sum = 0;
        for (const std::uint32_t count : counts) sum += count;
        statistics.mean = static_cast<double>(sum) / static_cast<double>(counts.size());
    }

    const auto range = parse_range(options, statistics);
    if (!range) return tl::unexpected(range.error());
    statistics.range_low = range->low;
    statistics.range_high = range->high;
    const auto share = [&](auto outside) {
        const auto pixels = std::count_if(counts.begin(), counts.end(), outside);
        return counts.empty() ? 0
                              : static_cast<double>(pixels) / static_cast<double>(counts.size());
    };
    statistics.clipped = share([&](std::uint32_t count) { return count > range->high; });
    statistics.below = share([&](std::uint32_t count) { return count < range->low; });
    return statistics;
}

}  // namespace raynest
