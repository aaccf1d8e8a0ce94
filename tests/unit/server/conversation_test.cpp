// The protocol's state machine over plain memory, with whatever a client may send in any order.
#include "server/conversation.h"

#include "engine/math/random.h"
#include "tests/golden/examples.h"
#include "tests/unit/server/small_daemon.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <memory>
#include <utility>
#include <vector>

namespace raynest::server {
namespace {

using test::SmallDaemon;

template <class Native>
protocol::Frame frame_of(std::uint64_t id, const Native& message) {
    return protocol::encode(id, message).value();
}

wire::QueryT query_of(std::uint64_t rays) {
    wire::QueryT query;
    query.job = std::make_unique<wire::JobT>();
    query.job->scene = "forest";
    query.ray_count = rays;
    return query;
}

/// The codes of what was answered with an error, in order.
std::vector<Code> errors_of(const SmallDaemon& daemon) {
    std::vector<Code> codes;
    for (const protocol::Frame& frame : daemon.sent)
        if (const auto error = protocol::open<wire::Error>(frame))
            codes.push_back(static_cast<Code>((*error)->code()));
    return codes;
}

TEST_CASE("nothing but a greeting opens a conversation") {
    SmallDaemon daemon;
    for (const golden::Example& example : golden::examples()) {
        daemon.sent.clear();
        Conversation conversation(daemon.services, daemon.engine, daemon, "me");
        conversation.receive(golden::copy(example.frame));
        CHECK(conversation.greeted() == (example.name == "Hello"));
        CHECK(conversation.closing() == (example.name != "Hello"));
        CHECK(daemon.sent.size() == 1);
    }
}

TEST_CASE("a draining conversation answers questions, refuses jobs and ends with the last one") {
    SmallDaemon daemon;
    Conversation conversation(daemon.services, daemon.engine, daemon, "me");
    conversation.receive(frame_of(0, wire::HelloT{}));
    wire::QueryT query;
    query.job = std::make_unique<wire::JobT>();
    query.job->scene = "forest";
    query.ray_count = 1;
    conversation.receive(frame_of(1, query));
    CHECK(daemon.said(wire::Message::Started));
    conversation.drain();
    CHECK_FALSE(conversation.closing());
    conversation.receive(frame_of(2, wire::VariantsT{}));
    CHECK(daemon.said(wire::Message::VariantList));
    conversation.receive(frame_of(3, query));
    CHECK(daemon.said(wire::Message::Error));
    conversation.receive(frame_of(1, wire::CancelT{}));
    CHECK(conversation.closing());
}

TEST_CASE(
    "a detached query runs on when its rays have come, and ends with its client before that") {
    SmallDaemon daemon;
    wire::QueryT query;
    query.job = std::make_unique<wire::JobT>();
    query.job->scene = "forest";
    query.job->detach = true;
    query.ray_count = 2;
    const auto rays = [](std::uint64_t first) {
        protocol::Bulk bulk;
        bulk.add("rays", wire::Dtype::f32, 8, 1);
        bulk.allocate();
        const std::array<float, 8> down = {0, 9, 0, 0, 0, -1, 0, 100};
        std::copy(down.begin(), down.end(), bulk.block_as<float>(0).begin());
        wire::QueryRaysT message;
        message.first_ray = first;
        return protocol::encode(1, std::move(message), std::move(bulk)).value();
    };
    for (const bool all : {false, true}) {
        CAPTURE(all);
        daemon.sent.clear();
        {
            Conversation conversation(daemon.services, daemon.engine, daemon, "me");
            conversation.receive(frame_of(0, wire::HelloT{}));
            conversation.receive(frame_of(1, query));
            conversation.receive(rays(0));
            CHECK_FALSE(daemon.said(wire::Message::Detached));
            if (all) conversation.receive(rays(1));
            CHECK(daemon.said(wire::Message::Detached) == all);
            // The id is free again, and what was detached is not this connection's any more.
            if (all) conversation.receive(frame_of(1, wire::CancelT{}));
        }
        daemon.settle();
        CHECK(daemon.detached.all().size() == (all ? 1 : 0));
        CHECK_FALSE(daemon.said(wire::Message::Chunk));
        CHECK_FALSE(daemon.said(wire::Message::Error));
    }
    const auto& job = *daemon.detached.all().begin()->second;
    CHECK(job.ended());
    CHECK_FALSE(job.error());
    CHECK(job.answer().front().header.type == static_cast<std::uint16_t>(wire::Message::Started));
}

TEST_CASE("a connection has so many requests in flight, those included that are to be detached") {
    SmallDaemon daemon;
    Conversation conversation(daemon.services, daemon.engine, daemon, "me");
    conversation.receive(frame_of(0, wire::HelloT{}));
    wire::QueryT detached = query_of(2);
    detached.job->detach = true;
    const std::uint64_t most = daemon.limits.jobs_max;
    for (std::uint64_t id = 1; id <= most; ++id)
        conversation.receive(id % 2 == 0 ? frame_of(id, query_of(2)) : frame_of(id, detached));
    CHECK(errors_of(daemon).empty());
    conversation.receive(frame_of(most + 1, query_of(2)));
    conversation.receive(frame_of(most + 1, detached));
    CHECK(errors_of(daemon) == std::vector{Code::quota, Code::quota});
    conversation.receive(frame_of(1, wire::CancelT{}));
    conversation.receive(frame_of(most + 1, detached));
    CHECK(errors_of(daemon) == std::vector{Code::quota, Code::quota, Code::cancelled});
}

TEST_CASE("data that is too large, and bulk of an unknown type, cost their request alone") {
    SmallDaemon daemon;
    Conversation conversation(daemon.services, daemon.engine, daemon, "me");
    conversation.receive(frame_of(0, wire::HelloT{}));
    protocol::FrameDecoder decoder(daemon.limits);
    decoder.set_admission(
        [&](const protocol::FrameHeader& header) { return conversation.admit(header); });
    const auto say = [&](const protocol::Frame& frame) {
        const std::vector<std::byte> bytes = golden::wire_bytes(frame);
        REQUIRE(decoder.feed(bytes) == bytes.size());
        REQUIRE(decoder.complete());
        conversation.receive(decoder.take());
    };
    const auto rays_of = [](std::uint32_t stride) {
        protocol::Bulk bulk;
        bulk.add("rays", wire::Dtype::f32, stride / sizeof(float), (16U << 10) + 1);
        bulk.allocate();
        std::fill_n(bulk.block(0).data(), bulk.block(0).size(), std::byte{0});
        return protocol::encode(1, wire::QueryRaysT{}, std::move(bulk)).value();
    };
    const auto piece_of = [](std::uint64_t bytes) {
        protocol::Bulk bulk;
        bulk.add("data", wire::Dtype::u8, 1, bytes);
        bulk.allocate();
        std::fill_n(bulk.block(0).data(), bytes, std::byte{0});
        return protocol::encode(1, wire::UploadT{}, std::move(bulk)).value();
    };
    protocol::Frame unknown = piece_of(1000);
    unknown.header.type = 99;
    REQUIRE_FALSE(protocol::message_known(99));
    const std::array<std::pair<protocol::Frame, Code>, 4> cases = {
        {{rays_of(32), Code::limit_exceeded},
         {rays_of(24), Code::invalid_field},
         {piece_of((8U << 20) + 1), Code::limit_exceeded},
         {std::move(unknown), Code::unknown_type}}};
    for (const auto& [frame, code] : cases) {
        CAPTURE(frame.header.type);
        conversation.receive(frame_of(1, query_of(1U << 20)));
        daemon.sent.clear();
        say(frame);
        CHECK(errors_of(daemon) == std::vector{code});
        CHECK_FALSE(conversation.closing());
        conversation.receive(frame_of(1, wire::CancelT{}));
    }
    // What no request of any version brings bulk with.
    protocol::Frame query = piece_of(1000);
    query.header.type = static_cast<std::uint16_t>(wire::Message::Query);
    const auto refused = conversation.admit(query.header);
    REQUIRE_FALSE(refused);
    CHECK(refused.error().code == Code::limit_exceeded);
}

TEST_CASE("a bad credit or cancel ends its request, and is ignored where that has ended") {
    SmallDaemon daemon;
    Conversation conversation(daemon.services, daemon.engine, daemon, "me");
    conversation.receive(frame_of(0, wire::HelloT{}));
    const auto credit_of = [](std::uint64_t bytes) {
        wire::CreditT credit;
        credit.bytes = bytes;
        return frame_of(1, credit);
    };
    const auto garbled = [](protocol::Frame frame) {
        std::fill_n(frame.control.data(), frame.control.size(), std::byte{0xff});
        return frame;
    };
    const auto ray = [](std::uint64_t first) {
        protocol::Bulk bulk;
        bulk.add("rays", wire::Dtype::f32, 8, 1);
        bulk.allocate();
        std::fill_n(bulk.block(0).data(), bulk.block(0).size(), std::byte{0});
        wire::QueryRaysT message;
        message.first_ray = first;
        return protocol::encode(1, std::move(message), std::move(bulk)).value();
    };
    std::vector<std::pair<protocol::Frame, Code>> cases;
    cases.emplace_back(credit_of(0), Code::invalid_field);
    cases.emplace_back(credit_of(~std::uint64_t{0}), Code::limit_exceeded);
    cases.emplace_back(garbled(credit_of(1)), Code::bad_frame);
    cases.emplace_back(garbled(frame_of(1, wire::CancelT{})), Code::bad_frame);
    for (const auto& [frame, code] : cases)
        for (const bool detached : {false, true}) {
            CAPTURE(code);
            CAPTURE(detached);
            wire::QueryT query = query_of(2);
            query.job->detach = detached;
            conversation.receive(frame_of(1, query));
            conversation.receive(ray(0));
            daemon.sent.clear();
            conversation.receive(golden::copy(frame));
            CHECK(errors_of(daemon) == std::vector{code});
            conversation.receive(ray(1));
            conversation.receive(golden::copy(frame));
            conversation.receive(credit_of(1));
            daemon.settle();
            CHECK(daemon.sent.size() == 1);
            CHECK_FALSE(conversation.closing());
        }
    CHECK(daemon.admission.active() == 0);
}

TEST_CASE(
    "credit for the rays of an all-hits query comes back once their whole frame is answered") {
    constexpr std::uint64_t frame_rays = 16U << 10;
    SmallDaemon daemon;
    Conversation conversation(daemon.services, daemon.engine, daemon, "me");
    wire::HelloT hello;
    hello.window_bytes = 64 << 10;  // for answers of fewer rays than a frame has
    conversation.receive(frame_of(0, hello));
    wire::QueryT query = query_of(5 * frame_rays);
    query.kind = "all";
    query.max_hits = 8;
    conversation.receive(frame_of(1, query));
    for (std::uint64_t frame = 0; frame < 5; ++frame) {
        protocol::Bulk bulk;
        bulk.add("rays", wire::Dtype::f32, 8, frame_rays);
        bulk.allocate();
        std::fill_n(bulk.block(0).data(), bulk.block(0).size(), std::byte{0});
        wire::QueryRaysT message;
        message.first_ray = frame * frame_rays;
        conversation.receive(protocol::encode(1, std::move(message), std::move(bulk)).value());
    }
    std::uint64_t answered = 0;
    std::uint64_t chunks = 0;
    std::uint64_t granted = 0;
    while (daemon.step()) {
        for (const protocol::Frame& frame : std::exchange(daemon.sent, {})) {
            if (const auto chunk = protocol::open<wire::Chunk>(frame)) {
                answered += (*chunk)->count();
                ++chunks;
            }
            if (const auto credit = protocol::open<wire::Credit>(frame))
                granted += (*credit)->bytes();
        }
        CHECK(granted <= answered / frame_rays * frame_rays * sizeof(Ray));
        wire::CreditT credit;
        credit.bytes = hello.window_bytes;
        conversation.receive(frame_of(1, credit));
    }
    CHECK(answered == 5 * frame_rays);
    CHECK(chunks > 5);
    CHECK(granted >= daemon.limits.window_bytes / 4);
}

TEST_CASE("visible_pixels counts no more rays than its counters hold") {
    SmallDaemon daemon;
    Conversation conversation(daemon.services, daemon.engine, daemon, "me");
    conversation.receive(frame_of(0, wire::HelloT{}));
    for (const std::uint64_t points : {65535U, 65536U}) {
        wire::QueryT query = query_of(points);
        query.reduce = "visible_pixels";
        query.generator = std::make_unique<wire::GeneratorT>();
        query.generator->kind = "hemisphere";
        query.generator->samples = 65536;
        conversation.receive(frame_of(points, query));
    }
    CHECK(daemon.said(wire::Message::Started));
    CHECK(errors_of(daemon) == std::vector{Code::limit_exceeded});
}

TEST_CASE("an answer is fetched where half of the window holds its frames") {
    SmallDaemon daemon;
    Conversation asking(daemon.services, daemon.engine, daemon, "me");
    asking.receive(frame_of(0, wire::HelloT{}));
    wire::QueryT query = query_of(0);
    query.job->detach = true;
    query.generator = std::make_unique<wire::GeneratorT>();
    query.generator->kind = "pinhole";
    query.generator->width = query.generator->height = 128;
    query.generator->fx = query.generator->fy = 64;
    asking.receive(frame_of(1, query));
    daemon.settle();
    const auto& [number, job] = *daemon.detached.all().begin();
    REQUIRE(job->ended());
    std::uint64_t largest = 0;
    for (const protocol::Frame& frame : job->answer())
        largest = std::max(largest, frame.header.bulk_bytes);
    REQUIRE(largest >= 64 << 10);
    wire::FetchT fetch;
    fetch.job = number;
    for (const std::uint64_t window : {2 * largest - 64, 2 * largest}) {
        daemon.sent.clear();
        Conversation fetching(daemon.services, daemon.engine, daemon, "me");
        wire::HelloT hello;
        hello.window_bytes = window;
        fetching.receive(frame_of(0, hello));
        fetching.receive(frame_of(1, fetch));
        daemon.settle();
        CHECK(daemon.said(wire::Message::Error) == (window < 2 * largest));
        CHECK(daemon.said(wire::Message::Started) == (window == 2 * largest));
    }
}

TEST_CASE("a detached query that goes wrong while its rays come tells its client") {
    SmallDaemon daemon;
    Conversation conversation(daemon.services, daemon.engine, daemon, "me");
    conversation.receive(frame_of(0, wire::HelloT{}));
    wire::QueryT query;
    query.job = std::make_unique<wire::JobT>();
    query.job->scene = "forest";
    query.job->detach = true;
    query.ray_count = 2;
    conversation.receive(frame_of(1, query));
    conversation.receive(frame_of(1, wire::QueryRaysT{}));  // without its block
    CHECK(daemon.said(wire::Message::Error));
    CHECK_FALSE(daemon.said(wire::Message::Detached));
    daemon.sent.clear();
    conversation.receive(frame_of(1, query));
    CHECK_FALSE(daemon.said(wire::Message::Error));
    conversation.receive(frame_of(1, wire::CancelT{}));
    CHECK(daemon.said(wire::Message::Error));
    CHECK(daemon.admission.active() == 0);
}

TEST_CASE("whatever frames come in whatever order, all jobs end and all memory returns") {
    SmallDaemon daemon;
    const std::uint64_t idle_bytes = daemon.budget.used();
    // What only a daemon says would end the conversation at once.
    auto examples = golden::examples();
    std::erase_if(examples, [](const golden::Example& example) {
        return example.name == "Hello" || example.frame.header.type >= 128;
    });
    Random random(20);
    for (int round = 0; round < 1000; ++round) {
        INFO("round ", round);
        daemon.sent.clear();
        Conversation conversation(daemon.services, daemon.engine, daemon, "me");
        protocol::FrameDecoder decoder(daemon.limits);
        conversation.receive(frame_of(0, wire::HelloT{}));
        for (int step = 0; step < 12 && !conversation.closing(); ++step) {
            const auto& example = examples[random.next() % examples.size()];
            std::vector<std::byte> bytes = golden::wire_bytes(example.frame);
            // Half of the frames are damaged somewhere behind the header.
            if (random.next() % 2 == 0 && bytes.size() > protocol::header_bytes) {
                const std::size_t at = protocol::header_bytes +
                                       random.next() % (bytes.size() - protocol::header_bytes);
                bytes[at] ^= static_cast<std::byte>(1 + random.next() % 255);
            }
            const auto taken = decoder.feed(bytes);
            REQUIRE(taken);
            REQUIRE(decoder.complete());
            conversation.receive(decoder.take());
        }
        conversation.abandon();
        daemon.detached.stop_running();
        daemon.settle();
        const auto kept = daemon.detached.all();
        for (const auto& [number, job] : kept) daemon.detached.cancel(number);
        CHECK(daemon.metrics.jobs_started == daemon.metrics.jobs_ended);
    }
    CHECK(daemon.budget.used() == idle_bytes);
    MESSAGE(daemon.metrics.jobs_started.load(), " jobs");
}

}  // namespace
}  // namespace raynest::server
