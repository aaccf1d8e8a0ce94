#include "server/store/budget.h"

#include <doctest/doctest.h>

#include <cstdint>
#include <utility>

namespace raynest::server {
namespace {

TEST_CASE("a budget gives what it has, and gets it back") {
    Budget budget(100);
    {
        auto a = budget.reserve(60);
        REQUIRE(a);
        CHECK_FALSE(budget.reserve(41));
        auto b = budget.reserve(40);
        REQUIRE(b);
        CHECK(budget.used() == 100);
        *a = Budget::Lease();
        CHECK(budget.used() == 40);
    }
    CHECK(budget.used() == 0);
}

TEST_CASE("no size of a reservation overflows") {
    Budget budget(100);
    const auto some = budget.reserve(1);
    CHECK_FALSE(budget.reserve(~std::uint64_t{0}));
    CHECK_FALSE(budget.reserve(~std::uint64_t{0} - 1));
    CHECK(budget.used() == 1);
}

TEST_CASE("a moved lease is given back once") {
    Budget budget(100);
    {
        auto lease = budget.reserve(10);
        const Budget::Lease moved = std::move(*lease);
        CHECK(budget.used() == 10);
    }
    CHECK(budget.used() == 0);
}

}  // namespace
}  // namespace raynest::server
