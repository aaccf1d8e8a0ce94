#include "server/security/quotas.h"

#include <doctest/doctest.h>

namespace raynest::server {
namespace {

TEST_CASE("an administrator's quota counts before the token's, and that before the usual one") {
    protocol::Limits limits;
    limits.principal_jobs_max = 50;
    Quotas quotas(limits);
    CHECK(quotas.of("alice").jobs == 50);
    quotas.grant("alice", {.jobs = 8, .rays = 7});
    CHECK(quotas.of("alice").jobs == 8);
    quotas.set("alice", {.jobs = 3});
    quotas.grant("alice", {.jobs = 9, .rays = 7});
    CHECK(quotas.of("alice").jobs == 3);
    CHECK(quotas.of("alice").rays == 7);
    quotas.set("alice", {});
    quotas.grant("alice", {});
    CHECK(quotas.of("alice").jobs == 50);
}

TEST_CASE("a refusal names the quota where there is one, and else the option") {
    protocol::Limits limits;
    limits.principal_scene_bytes_max = 1000;
    Quotas quotas(limits);
    CHECK(quotas.limit_text("bob", &Quota::scene_bytes) ==
          "the limit is --principal-scene-bytes-max 1000");
    CHECK(quotas.remedy("bob", &Quota::scene_bytes) ==
          "start raynestd with a larger --principal-scene-bytes-max");
    quotas.grant("bob", {.scene_bytes = 10});
    CHECK(quotas.limit_text("bob", &Quota::scene_bytes) == "its quota is scene_bytes=10");
    CHECK(quotas.remedy("bob", &Quota::scene_bytes) ==
          "ask an administrator for more: raynest admin quota bob scene_bytes=N");
    CHECK_FALSE(quotas.is_own("bob", &Quota::jobs));
}

TEST_CASE("a quota has keys, each once, and sensible values") {
    CHECK(read_quota("jobs=8,second_bytes=65536")->second_bytes == 65536);
    for (const char* wrong : {"", "jobs", "jobs=0", "jobs=1,", "jobs=1,jobs=1", "cars=1",
                              "second_bytes=65535", "second_bytes=1,jobs=1"})
        CHECK_FALSE_MESSAGE(read_quota(wrong), wrong);
    CHECK(read_quota("second_bytes=1").error().message ==
          "'second_bytes=1' is not a quota: the least second_bytes is 65536");
}

}  // namespace
}  // namespace raynest::server
