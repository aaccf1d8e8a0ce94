#include "tests/bench/load_test/latencies.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

using raynest::client::Latencies;
using std::chrono::nanoseconds;

TEST_CASE("percentiles of any size are within one percent of sorting") {
    std::mt19937_64 random(7);
    std::vector<double> sorted;
    Latencies latencies;
    for (int i = 0; i < 20'000; ++i) {
        const double value = std::exp2(40.0 * static_cast<double>(random() >> 11) * 0x1p-53);
        sorted.push_back(std::floor(value));
        latencies.add(nanoseconds(static_cast<std::int64_t>(value)));
    }
    std::sort(sorted.begin(), sorted.end());
    CHECK(latencies.count() == 20'000);
    CHECK(latencies.max_us() == doctest::Approx(sorted.back() / 1e3));
    for (const double share : {0.001, 0.01, 0.5, 0.99, 0.999}) {
        const auto rank = static_cast<std::size_t>(share * 20'000) - 1;
        CAPTURE(share);
        CHECK(latencies.percentile_us(share) >= sorted[rank] / 1e3);
        CHECK(latencies.percentile_us(share) <= sorted[rank] / 1e3 * 1.01);
    }
    CHECK(latencies.percentile_us(1) == latencies.max_us());
}

TEST_CASE("any latency is counted, however short or long, and no latency gives 0") {
    Latencies latencies;
    CHECK(latencies.percentile_us(0.5) == 0);
    CHECK(latencies.max_us() == 0);
    latencies.add(nanoseconds(-5));
    CHECK(latencies.percentile_us(0.5) == 0);
    CHECK(latencies.count() == 1);
    latencies.add(nanoseconds::max());
    CHECK(latencies.percentile_us(1) == doctest::Approx(9.223372036854775807e15));
}
