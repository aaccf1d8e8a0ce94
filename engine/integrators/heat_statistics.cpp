// Exact statistics of a heat map and the range its colours span.
#include "engine/integrators/palette.h"
#include "engine/integrators/picture.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdlib>
#include <string>
#include <type_traits>
#include <vector>

namespace raynest {
namespace {

/// Counts are u32; a range beyond them would only flatten the picture.
constexpr double range_max = 4294967295.0;

tl::unexpected<Error> invalid(std::string message) {
    return fail(ErrorCode::param_invalid, std::move(message));
}

Result<void> check_options(const HeatOptions& options) {
    if (auto metric = parse_metric(options.metric); !metric) return tl::unexpected(metric.error());
    if (options.scale != "linear" && options.scale != "log") {
        return invalid("there is no scale '" + options.scale + "'; known: linear, log");
    }
    if (auto palette = find_palette(options.palette); !palette) {
        return tl::unexpected(palette.error());
    }
    return {};
}

/// The smallest value that at least `percent` of all pixels do not exceed (nearest rank).
template <class Value>
Value percentile(std::vector<Value>& values, std::uint64_t percent) {
    const std::uint64_t rank = (values.size() * percent + 99) / 100;
    const auto at =
        values.begin() + static_cast<std::ptrdiff_t>(std::max<std::uint64_t>(rank, 1) - 1);
    std::nth_element(values.begin(), at, values.end());
    return *at;
}

/// Where less than one pixel in a hundred differs, its 99th percentile is near zero and hides how
/// much it differs: below this share of the largest distance, only the pixels that differ count.
constexpr double reach_share_min = 0.01;

/// Where one in so many pixels above the least value has exactly the 99th percentile, a range that
/// ended there would draw them as it draws all that exceed them.
constexpr std::ptrdiff_t tied_one_in = 20;

/// Ends of the range that a word asks for: the largest value, or the 99th percentile; of
/// differences those of the distances from zero.
struct Reach {
    double most = 0;
    double p99 = 0;
};

/// The 99th percentile, or the largest value where many pixels have the percentile.
template <class Value>
Value end_of_most(std::vector<Value>& values, Value least) {
    const Value end = percentile(values, 99);
    const auto at_end = std::count(values.begin(), values.end(), end);
    const auto above =
        std::count_if(values.begin(), values.end(), [least](Value value) { return value > least; });
    return tied_one_in * at_end < above ? end : *std::max_element(values.begin(), values.end());
}

template <class Value>
Reach reach_of(std::span<const Value> values, const HeatStatistics& statistics) {
    if (values.empty()) return {};
    std::vector<std::int64_t> sizes;
    sizes.reserve(values.size());
    for (const Value value : values) sizes.push_back(std::abs(std::int64_t{value}));
    const std::int64_t most = std::max(-statistics.min, statistics.max);
    if constexpr (std::is_signed_v<Value>) {
        if (static_cast<double>(percentile(sizes, 99)) <
            reach_share_min * static_cast<double>(most))
            std::erase(sizes, 0);
        return {static_cast<double>(most),
                static_cast<double>(end_of_most(sizes, std::int64_t{0}))};
    } else {
        // The same everywhere is not the most: it gets the middle of the palette.
        if (most == statistics.min)
            return {2 * static_cast<double>(most), 2 * static_cast<double>(most)};
        return {static_cast<double>(most), static_cast<double>(end_of_most(sizes, statistics.min))};
    }
}

struct Range {
    double low;
    double high;
};

Result<Range> parse_range(const HeatOptions& options, const Reach& reach, bool centred) {
    // A map of zeros still needs a range with a width.
    const auto up_to = [centred](double high) {
        high = std::max(1.0, high);
        return Range{centred ? -high : 0, high};
    };
    if (options.range == "auto") return up_to(reach.most);
    if (options.range == "p99") return up_to(reach.p99);

    const auto parse = [](std::string_view text, double& value) {
        const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
        return error == std::errc{} && end == text.data() + text.size() && std::isfinite(value);
    };
    const std::string_view text = options.range;
    const std::size_t colon = text.find(':');
    Range range{0, 0};
    const bool numbers = colon != std::string_view::npos &&
                         parse(text.substr(0, colon), range.low) &&
                         parse(text.substr(colon + 1), range.high) && range.low < range.high &&
                         range.high <= range_max;
    if (centred && !(numbers && range.low == -range.high))
        return invalid("the range '" + options.range +
                       "' of a difference is none of auto, p99 and "
                       "-high:high with 0 < high <= 4294967295");
    if (!centred && !(numbers && range.low >= 0))
        return invalid("the range '" + options.range +
                       "' is none of auto, p99 and low:high with 0 <= low < high <= 4294967295");
    return range;
}

template <class Value>
Result<HeatStatistics> measure(std::span<const Value> values, const HeatOptions& options) {
    if (auto checked = check_options(options); !checked) return tl::unexpected(checked.error());
    HeatStatistics statistics;
    statistics.rays = values.size();
    if (!values.empty()) {
        std::vector<Value> sorted(values.begin(), values.end());
        statistics.p50 = percentile(sorted, 50);
        statistics.p90 = percentile(sorted, 90);
        statistics.p99 = percentile(sorted, 99);
        const auto [least, most] = std::minmax_element(values.begin(), values.end());
        statistics.min = *least;
        statistics.max = *most;
        std::int64_t sum = 0;
        for (const Value value : values) sum += value;
        statistics.mean = static_cast<double>(sum) / static_cast<double>(values.size());
    }

    const auto range = parse_range(options, reach_of(values, statistics), std::is_signed_v<Value>);
    if (!range) return tl::unexpected(range.error());
    statistics.range_low = range->low;
    statistics.range_high = range->high;
    const auto share = [&](auto outside) {
        const auto pixels = std::count_if(values.begin(), values.end(), outside);
        return values.empty() ? 0
                              : static_cast<double>(pixels) / static_cast<double>(values.size());
    };
    statistics.clipped = share([&](Value value) { return value > range->high; });
    statistics.below = share([&](Value value) { return value < range->low; });
    return statistics;
}

}  // namespace

Result<HeatMetric> parse_metric(const std::string& name) {
    HeatMetric metric;
#define RAYNEST_MEASURE(word, title) \
    if (name == #word) metric.measure = Measure::word;
#include "engine/integrators/measures.def"
    if (metric.measure != Measure::none) return metric;
    const auto column = parse_column(name);
    const auto dot = name.find('.');
    if (!column && dot != std::string::npos && parse_field(name.substr(0, dot)))
        return tl::unexpected(column.error());
    if (!column || !field_info(column->field).counter) {
        std::string known;
        for (const FieldInfo& counter : counter_table()) known += std::string(counter.name) + ", ";
#define RAYNEST_MEASURE(word, title) known += #word ", ";
#include "engine/integrators/measures.def"
        known.resize(known.size() - 2);
        return invalid("there is no metric '" + name + "'; known: " + known);
    }
    metric.counter = *column;
    return metric;
}

std::string metric_name(const HeatMetric& metric) {
    switch (metric.measure) {
#define RAYNEST_MEASURE(word, title) \
    case Measure::word:              \
        return #word;
#include "engine/integrators/measures.def"
        case Measure::none:
            break;
    }
    return column_name(metric.counter);
}

Result<HeatStatistics> heat_statistics(std::span<const std::uint32_t> counts,
                                       const HeatOptions& options) {
    return measure(counts, options);
}

Result<HeatStatistics> heat_statistics(std::span<const std::int32_t> differences,
                                       const HeatOptions& options) {
    return measure(differences, options);
}

template <class Value>
std::vector<std::uint64_t> heat_histogram(std::span<const Value> values,
                                          const HeatStatistics& statistics) {
    std::vector<std::uint64_t> bars(heat_bars);
    const double width = static_cast<double>(statistics.max - statistics.min) + 1;
    for (const Value value : values) {
        const auto place = static_cast<double>(std::int64_t{value} - statistics.min) / width;
        ++bars[std::min(static_cast<std::size_t>(place * heat_bars), heat_bars - 1)];
    }
    return bars;
}

template std::vector<std::uint64_t> heat_histogram(std::span<const std::uint32_t>,
                                                   const HeatStatistics&);
template std::vector<std::uint64_t> heat_histogram(std::span<const std::int32_t>,
                                                   const HeatStatistics&);

}  // namespace raynest
