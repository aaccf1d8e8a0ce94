// Round-trip times as counts per bucket: any number of them in fixed memory, within 1 %.
#pragma once

#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>

namespace raynest::client {

class Latencies {
public:
    void add(std::chrono::nanoseconds latency);

    [[nodiscard]] std::uint64_t count() const { return count_; }
    /// The time in microseconds that `share` of them did not exceed; 0 when there are none.
    [[nodiscard]] double percentile_us(double share) const;
    [[nodiscard]] double max_us() const { return static_cast<double>(max_) / 1e3; }

private:
    /// Buckets of every power of two: the width of one is below 1 % of what lies in it.
    static constexpr unsigned split_bits = 7;
    static constexpr std::size_t split = 1U << split_bits;
    static constexpr std::size_t bucket_count = split * (65 - split_bits);
    static std::size_t bucket_of(std::uint64_t value);
    static std::uint64_t upper_end(std::size_t bucket);

    std::array<std::uint64_t, bucket_count> buckets_{};
    std::uint64_t count_ = 0;
    std::uint64_t max_ = 0;
};

}  // namespace raynest::client
