#include "tests/bench/load_test/latencies.h"

#include <algorithm>
#include <bit>
#include <cmath>

namespace raynest::client {

// Values below `split` have a bucket each. Above that, the highest bit selects a row, and the next
// split_bits bits select a bucket in the row.
std::size_t Latencies::bucket_of(std::uint64_t value) {
    if (value < split) return value;
    const auto shift = static_cast<unsigned>(std::bit_width(value)) - 1 - split_bits;
    return split * (shift + 1) + ((value >> shift) - split);
}

std::uint64_t Latencies::upper_end(std::size_t bucket) {
    if (bucket < split) return bucket;
    const std::size_t shift = bucket / split - 1;
    return ((bucket % split + split + 1) << shift) - 1;
}

void Latencies::add(std::chrono::nanoseconds latency) {
    const auto value = static_cast<std::uint64_t>(std::max<std::int64_t>(0, latency.count()));
    ++buckets_[bucket_of(value)];
    ++count_;
    max_ = std::max(max_, value);
}

double Latencies::percentile_us(double share) const {
    const auto rank = static_cast<std::uint64_t>(std::ceil(share * static_cast<double>(count_)));
    std::uint64_t seen = 0;
    for (std::size_t bucket = 0; bucket < buckets_.size(); ++bucket) {
        seen += buckets_[bucket];
        if (seen != 0 && seen >= rank)
            return static_cast<double>(std::min(upper_end(bucket), max_)) / 1e3;
    }
    return 0;
}

}  // namespace raynest::client
