#include "server/jobs/workers.h"

#include <doctest/doctest.h>

#include <atomic>
#include <future>

namespace raynest::server {
namespace {

TEST_CASE("tasks of one worker run in the order of their submission") {
    std::vector<int> order;
    std::promise<void> done;
    Workers workers(1);
    for (int i = 0; i < 100; ++i) workers.submit([&order, i] { order.push_back(i); });
    workers.submit([&done] { done.set_value(); });
    done.get_future().wait();
    REQUIRE(order.size() == 100);
    for (int i = 0; i < 100; ++i) CHECK(order[static_cast<std::size_t>(i)] == i);
}

TEST_CASE("without threads each task waits to be run here") {
    Workers workers(0);
    int ran = 0;
    for (int i = 0; i < 2; ++i) workers.submit([&ran] { ++ran; });
    CHECK(ran == 0);
    CHECK(workers.run_one());
    CHECK(ran == 1);
    CHECK(workers.run_one());
    CHECK_FALSE(workers.run_one());
    CHECK(ran == 2);
}

TEST_CASE("workers run at the same time") {
    Workers workers(2);
    std::promise<void> a;
    std::promise<void> b;
    std::promise<void> met;
    // Each waits for the other: with one thread this would never end.
    workers.submit([&] {
        a.set_value();
        b.get_future().wait();
        met.set_value();
    });
    workers.submit([&] {
        a.get_future().wait();
        b.set_value();
    });
    CHECK(met.get_future().wait_for(std::chrono::seconds(10)) == std::future_status::ready);
}

TEST_CASE("ending waits for what runs and drops what does not") {
    std::atomic<int> ran{0};
    std::promise<void> started;
    std::promise<void> release;
    auto workers = std::make_unique<Workers>(1);
    workers->submit([&] {
        started.set_value();
        release.get_future().wait();
        ++ran;
    });
    started.get_future().wait();
    for (int i = 0; i < 10; ++i) workers->submit([&ran] { ++ran; });
    std::thread ending([&] { workers.reset(); });
    release.set_value();
    ending.join();
    CHECK(ran >= 1);
    CHECK(ran <= 11);
}

}  // namespace
}  // namespace raynest::server
