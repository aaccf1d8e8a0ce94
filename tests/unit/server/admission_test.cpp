#include "server/scheduling/admission.h"

#include <doctest/doctest.h>

#include <string>
#include <vector>

namespace raynest::server {
namespace {

protocol::Limits limits(std::uint64_t jobs) {
    protocol::Limits limits;
    limits.principal_jobs_max = 3;
    limits.principal_rays_max = 100;
    limits.total_jobs_max = jobs;
    return limits;
}

JobRecord asked(const std::string& principal, std::uint64_t rays) {
    JobRecord record;
    record.principal = principal;
    record.rays = rays;
    return record;
}

TEST_CASE("a full daemon admits again when a slot ends, and tells when to retry") {
    Admission admission(limits(2));
    auto a = admission.enter(asked("a", 0));
    const auto b = admission.enter(asked("b", 0));
    REQUIRE(a);
    REQUIRE(b);
    const auto refused = admission.enter(asked("c", 0));
    REQUIRE_FALSE(refused);
    CHECK(refused.error().code == Code::busy);
    CHECK(refused.error().retry_after_ms >= 10);
    admission.record(std::chrono::hours(10));
    CHECK(admission.retry_after_ms() == 10'000);
    *a = {};
    CHECK(admission.enter(asked("c", 0)));
}

TEST_CASE("one principal's jobs end at its quota, another's begin") {
    Admission admission(limits(10));
    std::vector<Admission::Slot> slots;
    for (int i = 0; i < 3; ++i)
        slots.push_back(std::move(admission.enter(asked("crowd", 0)).value()));
    const auto refused = admission.enter(asked("crowd", 0));
    REQUIRE_FALSE(refused);
    CHECK(refused.error().code == Code::quota);
    CHECK(refused.error().message.find("--principal-jobs-max 3") != std::string::npos);
    CHECK(admission.enter(asked("single", 0)));
    slots.pop_back();
    CHECK(admission.enter(asked("crowd", 0)));
}

TEST_CASE("rays in flight count over all jobs of a principal, and no number overflows") {
    Admission admission(limits(10));
    auto half = admission.enter(asked("me", 60));
    REQUIRE(half);
    // A retry can succeed for the first number, but never for the others.
    for (const std::uint64_t rays : {std::uint64_t{41}, std::uint64_t{101}, ~std::uint64_t{0}}) {
        const auto refused = admission.enter(asked("me", rays));
        REQUIRE_FALSE(refused);
        CHECK(refused.error().code == (rays == 41 ? Code::quota : Code::limit_exceeded));
        CHECK(refused.error().message.find("--principal-rays-max 100") != std::string::npos);
    }
    CHECK(admission.enter(asked("me", 40)));
    CHECK(admission.enter(asked("other", 100)));
    *half = {};
    CHECK(admission.enter(asked("me", 100)));
    CHECK(admission.active() == 0);
}

TEST_CASE("a job that ends gives back its rays while another goes on") {
    Admission admission(limits(10));
    auto first = admission.enter(asked("me", 60));
    const auto second = admission.enter(asked("me", 40));
    *first = {};
    CHECK(admission.enter(asked("me", 60)));
    CHECK_FALSE(admission.enter(asked("me", 61)));
}

TEST_CASE("every job has a number of its own, and is known while it is in flight") {
    Admission admission(limits(10));
    auto first = admission.enter(asked("me", 5));
    const std::uint64_t number = first->number();
    REQUIRE(admission.find(number) != nullptr);
    CHECK(admission.find(number)->principal == "me");
    CHECK(admission.find(number)->rays == 5);
    *first = {};
    CHECK(admission.find(number) == nullptr);
    CHECK(admission.enter(asked("me", 5))->number() > number);
}

TEST_CASE("principals that take all they can leave a place for the next one") {
    protocol::Limits limits;
    limits.principal_jobs_max = limits.total_jobs_max = 1000;
    Admission admission(limits);
    std::vector<Admission::Slot> slots;
    for (const std::string greedy : {"a", "b", "c", "d"}) {
        auto entered = admission.enter(asked(greedy, 0));
        REQUIRE(entered);
        for (; entered; entered = admission.enter(asked(greedy, 0)))
            slots.push_back(std::move(*entered));
        CHECK(entered.error().code == Code::busy);
        CHECK(entered.error().retry_after_ms >= 10);
        CHECK(entered.error().message.starts_with(greedy + " has "));
        // Its own paused peers may give way for it, not those of others.
        CHECK(admission.blocking_limit(greedy) == Peers::Whose::own);
    }
    CHECK(admission.active_of("a") == 800);
    CHECK(admission.enter(asked("single", 0)));
}

}  // namespace
}  // namespace raynest::server
