#include "server/ground/budget.h"

#include <doctest/doctest.h>

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

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

/// Reserves as much as the principal may have.
std::vector<Budget::Lease> take_all(Budget& budget, const std::string& principal, Use use) {
    std::vector<Budget::Lease> leases;
    while (const std::uint64_t room = budget.room(principal, use))
        leases.push_back(std::move(budget.reserve((room + 1) / 2, principal, use).value()));
    return leases;
}

TEST_CASE("principals that take all they can leave something to the next one") {
    constexpr std::uint64_t limit = 1 << 20;
    Budget budget(limit);
    std::vector<std::vector<Budget::Lease>> greedy;
    for (std::uint64_t n = 1; n <= 5; ++n) {
        greedy.push_back(take_all(budget, "greedy" + std::to_string(n), Use::passing));
        CHECK(limit - budget.used() > 0);
        CHECK(budget.reserve(budget.room("single", Use::passing), "single"));
        CHECK(budget.room("single", Use::passing) > 0);
    }
    // Alone it has four fifths.
    CHECK(budget.held_by("greedy1") >= limit / 5 * 4 - 8);
    CHECK(budget.held_by("greedy1") <= limit / 5 * 4);
}

TEST_CASE("what lasts leaves the reserve to requests") {
    constexpr std::uint64_t limit = 1 << 20;
    Budget budget(limit);
    std::vector<std::vector<Budget::Lease>> scenes;
    for (int i = 0; i < 5; ++i) scenes.push_back(take_all(budget, std::to_string(i), Use::lasting));
    CHECK(budget.room("new", Use::lasting) > 0);
    CHECK(budget.used() <= limit - limit / Budget::reserve_part);
    CHECK(budget.room("new", Use::passing) >= limit / Budget::reserve_part / 5 * 4);
    CHECK(budget.room("0", Use::passing) == budget.room("new", Use::passing));
    // The daemon's own buffers take what is there.
    CHECK(budget.room("", Use::passing) == limit - budget.used());
}

TEST_CASE("requests use the reserve before they take from what scenes may have") {
    Budget budget(800);
    const std::uint64_t before = budget.room("a", Use::lasting);
    const auto small = budget.reserve(100, "b");
    CHECK(budget.room("a", Use::lasting) == before);
    const auto more = budget.reserve(100, "b");
    CHECK(budget.room("a", Use::lasting) == before - 80);
    CHECK(budget.room("a", Use::lasting, {.requests = 100}) == before);
}

TEST_CASE("bytes can be charged to another principal, and are given back once") {
    Budget budget(1000);
    {
        auto lease = budget.reserve(100, "a", Use::lasting);
        REQUIRE(lease);
        lease->charge("b");
        CHECK(budget.held_by("a") == 0);
        CHECK(budget.held_by("b") == 100);
        lease->merge(std::move(budget.reserve(10, "b", Use::lasting).value()));
        CHECK(lease->bytes() == 110);
        CHECK(lease->principal() == "b");
    }
    CHECK(budget.used() == 0);
}

TEST_CASE("a refusal says what is asked for, and not who holds how much") {
    Budget budget(1 << 20);
    const auto others = budget.reserve(300'000, "other");
    const auto own = budget.reserve(200'000, "me", Use::lasting);
    const auto now = budget.refuse("the thing", 500'000, "me", "take less").value();
    CHECK(now.code == Code::resource_exhausted);
    CHECK(now.message ==
          "the thing takes 488.3 KiB of raynestd's --memory, more than me may take "
          "now; take less");
    CHECK(budget.refuse("the thing", 1 << 20, "me", "take less").value().message ==
          "the thing takes 1.0 MiB of raynestd's --memory, more than one user may have; take less");
}

}  // namespace
}  // namespace raynest::server
