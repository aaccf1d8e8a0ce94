#include "protocol/errors.h"

#include "protocol/limits.h"

#include <doctest/doctest.h>

#include <set>

using namespace raynest::protocol;

TEST_CASE("every error has a name of its own, a remedy and an exit code that exists") {
    std::set<int> exits;
    for (const ExitInfo& info : exit_table()) exits.insert(static_cast<int>(info.code));
    std::set<std::string_view> names;
    for (const ErrorInfo& info : error_table()) {
        CAPTURE(info.name);
        CHECK(names.insert(info.name).second);
        CHECK(info.remedy.size() > 10);
        CHECK(exits.contains(static_cast<int>(info.exit)));
        CHECK(error_info(info.code).name == info.name);
    }
    CHECK(names.size() == 23);
}

TEST_CASE("an unknown error number reads as INTERNAL") {
    CHECK(error_info(static_cast<Code>(0)).code == Code::internal);
    CHECK(error_info(static_cast<Code>(24)).code == Code::internal);
    CHECK(error_info(static_cast<Code>(0xFFFFFFFF)).code == Code::internal);
}

TEST_CASE("the limits of frames and scenes are in the table") {
    const Limits limits;
    std::set<std::string_view> names;
    for (const LimitInfo& info : limit_table()) {
        CHECK(names.insert(info.name).second);
        CHECK(limits.*info.value > 0);
    }
    CHECK(limits.control_bytes_max == 65536);
    CHECK(limits.frame_bytes_max == 67108864);
    CHECK(limits.chunk_rays_max == 16384);
    CHECK(limits.window_bytes == 8388608);
    CHECK(limits.window_bytes_max == 33554432);
    CHECK(limits.greeting_bytes_max == 4096);
    CHECK(limits.greeting_ms_max == 2000);
    CHECK(limits.control_depth_max == 16);
    CHECK(limits.control_tables_max == 256);
}
