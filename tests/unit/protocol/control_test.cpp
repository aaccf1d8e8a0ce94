#include "protocol/control.h"

#include "tests/golden/examples.h"

#include <doctest/doctest.h>

#include <cstdint>
#include <set>
#include <string>

using namespace raynest;
using protocol::Code;

TEST_CASE("THE LIST and the examples cover each other") {
    std::size_t known = 0;
    for (unsigned type = 0; type < 65536; ++type)
        if (protocol::message_known(static_cast<std::uint16_t>(type))) ++known;
    std::set<std::uint16_t> shown;
    for (const golden::Example& example : golden::examples())
        shown.insert(example.frame.header.type);
    CHECK(known == shown.size());
}

TEST_CASE("encode and open are inverse") {
    wire::QueryT query;
    query.job = std::make_unique<wire::JobT>();
    query.job->scene = "forest";
    query.job->settings = {"cutoff=0.01", "cull=back"};
    query.kind = "multi";
    query.fields = {"t", "uv"};
    query.max_hits = 4;
    query.ray_count = 1ULL << 33;
    const auto frame = protocol::encode(9, query);
    REQUIRE(frame);
    CHECK(frame->header.request_id == 9);
    const auto opened = protocol::open<wire::Query>(*frame);
    REQUIRE(opened);
    const wire::Query& read = *opened->table;
    const wire::Job& job = protocol::present(read.job());
    CHECK(protocol::text(job.scene()) == "forest");
    CHECK(protocol::strings(job.settings()) ==
          std::vector<std::string>{"cutoff=0.01", "cull=back"});
    CHECK(protocol::word(job.intersector(), "auto") == "auto");
    CHECK(protocol::word(read.kind(), "closest") == "multi");
    CHECK(job.mask() == 0xFFFFFFFF);
    CHECK(read.max_hits() == 4);
    CHECK(read.ray_count() == 1ULL << 33);
}

TEST_CASE("a frame of another type does not open") {
    const auto frame = protocol::encode(1, wire::PingT{});
    const auto opened = protocol::open<wire::Info>(*frame);
    REQUIRE(!opened);
    CHECK(opened.error().message == "expected Info, got Ping");
}

TEST_CASE("a message that grew over the control limit is refused by its sender") {
    wire::StatisticsT statistics;
    for (int i = 0; i < 400; ++i) statistics.names.push_back(std::string(200, 'x'));
    const auto frame = protocol::encode(1, statistics);
    REQUIRE(!frame);
    CHECK(frame.error().code == Code::limit_exceeded);
    CHECK(frame.error().message.find("Statistics") == 0);
}

TEST_CASE("an error frame is always valid, whatever its message holds") {
    for (const std::string& message :
         {std::string(), std::string("two\nlines \x1b[2J"), std::string("\xff\xfe"),
          std::string(4095, 'x') + "木木", std::string(5000, '\xff'), std::string(70000, 'y')}) {
        const protocol::Frame frame = protocol::encode_error(3, {Code::busy, message, 250}, false);
        const auto opened = protocol::open<wire::Error>(frame);
        REQUIRE(opened);
        CHECK(opened->table->code() == 12);
        CHECK(protocol::text(opened->table->name()) == "BUSY");
        CHECK(opened->table->retry_after_ms() == 250);
        CHECK(!protocol::text(opened->table->message()).empty());
    }
    const protocol::Frame cut =
        protocol::encode_error(3, {Code::busy, std::string(4095, 'x') + "木", 0}, true);
    CHECK(protocol::text(protocol::open<wire::Error>(cut).value()->message()) ==
          std::string(4095, 'x'));
}
