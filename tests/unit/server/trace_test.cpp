// The memory of chunks counts towards --memory and goes when nobody needs it.
#include "server/execution/trace.h"

#include <doctest/doctest.h>

#include <new>

namespace raynest::server {
namespace {

TEST_CASE("trace buffers count towards --memory, and go when they are not needed") {
    Budget budget(1 << 20);
    TraceBufferPool pool(budget);
    {
        const auto first = pool.take();
        const auto second = pool.take();
        first->resize(first->rays, 1000);
        second->resize(second->hits, 2000);
        CHECK(budget.used() == 1000 * sizeof(Ray) + 2000 * sizeof(HitRecord));
        (void)pool.trim();  // what is in use stays
        CHECK(first->rays.size() == 1000);
    }
    CHECK(budget.used() == 1000 * sizeof(Ray) + 2000 * sizeof(HitRecord));
    (void)pool.trim();
    CHECK(budget.used() == 1000 * sizeof(Ray) + 2000 * sizeof(HitRecord));
    {
        const auto again = pool.take();
        again->resize(again->hits, 5);
        again->resize(again->rays, 1000);
    }
    // One was used, by at least half of what it has; the other was not.
    (void)pool.trim();
    CHECK(budget.used() > 0);
    CHECK(budget.used() <= (1000 * sizeof(Ray)) + 2000 * sizeof(HitRecord));
    (void)pool.trim();
    CHECK(budget.used() == 0);
}

TEST_CASE("trace buffers that --memory has no room for fail their chunk, and nothing is lost") {
    Budget budget(1000 * sizeof(Ray));
    TraceBufferPool pool(budget);
    const auto buffers = pool.take();
    buffers->resize(buffers->rays, 900);
    CHECK_THROWS_AS(buffers->resize(buffers->rays, 1001), std::bad_alloc);
    CHECK(budget.used() == 0);
    buffers->resize(buffers->rays, 1000);
    CHECK(budget.used() == 1000 * sizeof(Ray));
}

}  // namespace
}  // namespace raynest::server
