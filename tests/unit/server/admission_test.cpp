#include "server/jobs/admission.h"

#include <doctest/doctest.h>

namespace raynest::server {
namespace {

protocol::Limits limits() {
    protocol::Limits limits;
    limits.principal_jobs_max = 3;
    limits.principal_rays_max = 100;
    return limits;
}

TEST_CASE("a full daemon admits again when a slot ends, and says when to come back") {
    Admission admission(2);
    auto a = admission.enter("a", 0);
    const auto b = admission.enter("b", 0);
    REQUIRE(a);
    REQUIRE(b);
    const auto refused = admission.enter("c", 0);
    REQUIRE_FALSE(refused);
    CHECK(refused.error().code == Code::busy);
    CHECK(refused.error().retry_after_ms >= 10);
    admission.record(std::chrono::hours(10));
    CHECK(admission.retry_after_ms() == 10'000);
    *a = {};
    CHECK(admission.enter("c", 0));
}

TEST_CASE("one principal's jobs end at its quota, another's begin") {
    Admission admission(10, limits());
    std::vector<Admission::Slot> slots;
    for (int i = 0; i < 3; ++i) slots.push_back(std::move(admission.enter("crowd", 0).value()));
    const auto refused = admission.enter("crowd", 0);
    REQUIRE_FALSE(refused);
    CHECK(refused.error().code == Code::quota);
    CHECK(refused.error().message.find("principal_jobs_max") != std::string::npos);
    CHECK(admission.enter("single", 0));
    slots.pop_back();
    CHECK(admission.enter("crowd", 0));
}

TEST_CASE("rays in flight count over all jobs of a principal, and no number overflows") {
    Admission admission(10, limits());
    auto half = admission.enter("me", 60);
    REQUIRE(half);
    for (const std::uint64_t rays : {std::uint64_t{41}, ~std::uint64_t{0}}) {
        const auto refused = admission.enter("me", rays);
        REQUIRE_FALSE(refused);
        CHECK(refused.error().code == Code::quota);
        CHECK(refused.error().message.find("principal_rays_max") != std::string::npos);
    }
    CHECK(admission.enter("me", 40));
    CHECK(admission.enter("other", 100));
    *half = {};
    CHECK(admission.enter("me", 100));
    CHECK(admission.active() == 0);
}

}  // namespace
}  // namespace raynest::server
