#include "server/store/disk_room.h"

#include <doctest/doctest.h>

#include <thread>
#include <vector>

using namespace raynest::server;

TEST_CASE("claims on the disk count for their owner until they end, on any thread") {
    Claims claims;
    auto first = claims.take("alice", {100, 1, 50});
    {
        const auto second = claims.take("alice", {20, 0, 2});
        const auto other = claims.take("bob", {7, 1, 7});
        CHECK(claims.of("alice") == Claim{120, 1, 52});
        CHECK(claims.of("bob") == Claim{7, 1, 7});
    }
    CHECK(claims.of("alice") == Claim{100, 1, 50});
    CHECK(claims.of("bob") == Claim());
    std::vector<std::thread> threads;
    for (int i = 0; i < 4; ++i)
        threads.emplace_back([&claims] {
            for (int k = 0; k < 1000; ++k) const auto taken = claims.take("alice", {1, 1, 1});
        });
    for (std::thread& thread : threads) thread.join();
    CHECK(claims.of("alice") == Claim{100, 1, 50});
    first.reset();
    CHECK(claims.of("alice") == Claim());
}

TEST_CASE("room on the disk is what may be stored, and no byte more") {
    const DiskRoom room{100, "alice", "unload scenes"};
    CHECK(room.check(100));
    REQUIRE(!room.check(101));
    CHECK(room.check(101).error().message.find("alice has room for 100 B") != std::string::npos);
}
