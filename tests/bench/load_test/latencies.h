// A histogram of round-trip times: any number of them in fixed memory, exact to 1 %.
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
    /// Returns the time in microseconds that a `share` of them did not exceed; 0 if there are none.
    [[nodiscard]] double percentile_us(double share) const;
    [[nodiscard]] double max_us() const { return static_cast<double>(max_) / 1e3; }

private:
    /// log2 of the buckets per power of two; a bucket is narrower than 1 % of its values.
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
