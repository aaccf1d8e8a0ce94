// Counts of a job's rays.
#include "server/execution/statistics.h"

#include <doctest/doctest.h>

#include <array>
#include <cstdint>
#include <vector>

namespace raynest::server {
namespace {

TEST_CASE("the first invalid ray has its number in the query, in whatever order it was traced") {
    std::vector<HitRecord> records(8);
    records[3].flags = records[5].flags = hit_invalid_ray;
    JobStatistics::Counts counts;
    counts.add_rays(records, {}, 1000);
    CHECK(counts.invalid == 2);
    CHECK(counts.first_invalid == 1003);
    constexpr std::array<std::uint32_t, 8> backwards = {7, 6, 5, 4, 3, 2, 1, 0};
    JobStatistics::Counts turned;
    turned.add_rays(records, backwards, 1000);
    CHECK(turned.invalid == 2);
    CHECK(turned.first_invalid == 1002);
}

}  // namespace
}  // namespace raynest::server
