// Runs the protocol's state machine in memory, with any frames in any order.
#include "server/sessions/conversation.h"

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

using test::Client;
using test::errors_of;
using test::frame_of;
using test::piece_of;
using test::SmallDaemon;

wire::QueryT query_of(std::uint64_t rays) {
    wire::QueryT query;
    query.job = std::make_unique<wire::JobT>();
    query.job->scene = "forest";
    query.ray_count = rays;
    return query;
}

TEST_CASE("nothing but a greeting opens a conversation") {
    SmallDaemon daemon;
    for (const golden::Example& example : golden::examples()) {
        daemon.sent.clear();
        Client conversation(daemon);
        conversation.receive(golden::copy(example.frame));
        CHECK(conversation.greeted() == (example.name == "Hello"));
        CHECK(conversation.closing() == (example.name != "Hello"));
        CHECK(daemon.sent.size() == 1);
    }
}

TEST_CASE("a draining conversation answers requests, refuses jobs and ends with the last one") {
    SmallDaemon daemon;
    Client conversation(daemon);
    conversation.receive(frame_of(0, wire::HelloT{}));
    const wire::QueryT query = query_of(1);
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
    wire::QueryT query = query_of(2);
    query.job->detach = true;
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
            Client conversation(daemon);
            conversation.receive(frame_of(0, wire::HelloT{}));
            conversation.receive(frame_of(1, query));
            conversation.receive(rays(0));
            CHECK_FALSE(daemon.said(wire::Message::Detached));
            if (all) conversation.receive(rays(1));
            CHECK(daemon.said(wire::Message::Detached) == all);
            // The id is free again, and the detached job no longer belongs to this connection.
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
    CHECK(job.answer().frames.front().header.type ==
          static_cast<std::uint16_t>(wire::Message::Started));
}

TEST_CASE("a connection has so many requests in flight, those included that are to be detached") {
    SmallDaemon daemon;
    Client conversation(daemon);
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
    Client conversation(daemon);
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
    const auto rays_of = [](std::uint32_t stride, std::uint64_t count) {
        protocol::Bulk bulk;
        bulk.add("rays", wire::Dtype::f32, stride / sizeof(float), count);
        bulk.allocate();
        std::fill_n(bulk.block(0).data(), bulk.block(0).size(), std::byte{0});
        return protocol::encode(1, wire::QueryRaysT{}, std::move(bulk)).value();
    };
    protocol::Frame unknown = piece_of(1000);
    unknown.header.type = 99;
    REQUIRE_FALSE(protocol::message_known(99));
    const std::array<std::pair<protocol::Frame, Code>, 4> cases = {
        {{rays_of(32, 20U << 10), Code::limit_exceeded},  // more than rays and masks take
         {rays_of(24, (16U << 10) + 1), Code::invalid_field},
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
    // No request of any version brings this kind of bulk.
    protocol::Frame query = piece_of(1000);
    query.header.type = static_cast<std::uint16_t>(wire::Message::Query);
    const auto refused = conversation.admit(query.header);
    REQUIRE_FALSE(refused);
    CHECK(refused.error().code == Code::limit_exceeded);
}

TEST_CASE("a bad credit or cancel ends its request, and is ignored where that has ended") {
    SmallDaemon daemon;
    Client conversation(daemon);
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
    Client conversation(daemon);
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
    Client conversation(daemon);
    conversation.receive(frame_of(0, wire::HelloT{}));
    for (const std::uint64_t points : {65535U, 65536U}) {
        wire::QueryT query = query_of(points);
        query.reduce = "visible_pixels";
        query.generator = std::make_unique<wire::GeneratorT>();
        query.generator->kind = "hemisphere";
        query.generator->settings = {"samples=65536"};
        conversation.receive(frame_of(points, query));
    }
    CHECK(daemon.said(wire::Message::Started));
    CHECK(errors_of(daemon) == std::vector{Code::limit_exceeded});
}

TEST_CASE("an answer is fetched where half of the window holds its frames") {
    SmallDaemon daemon;
    Client asking(daemon);
    asking.receive(frame_of(0, wire::HelloT{}));
    wire::QueryT query = query_of(0);
    query.job->detach = true;
    query.generator = std::make_unique<wire::GeneratorT>();
    query.generator->kind = "pinhole";
    query.generator->settings = {"size=128x128", "fx=64"};
    asking.receive(frame_of(1, query));
    daemon.settle();
    const auto& [number, job] = *daemon.detached.all().begin();
    REQUIRE(job->ended());
    std::uint64_t largest = 0;
    for (const protocol::Frame& frame : job->answer().frames)
        largest = std::max(largest, frame.header.bulk_bytes);
    REQUIRE(largest >= 64 << 10);
    wire::FetchT fetch;
    fetch.job = number;
    for (const std::uint64_t window : {2 * largest - 64, 2 * largest}) {
        daemon.sent.clear();
        Client fetching(daemon);
        wire::HelloT hello;
        hello.window_bytes = window;
        fetching.receive(frame_of(0, hello));
        fetching.receive(frame_of(1, fetch));
        daemon.settle();
        CHECK(daemon.said(wire::Message::Error) == (window < 2 * largest));
        CHECK(daemon.said(wire::Message::Started) == (window == 2 * largest));
    }
}

TEST_CASE("only the principal that started a job waits for it, fetches it and cancels it") {
    SmallDaemon daemon;
    Client owner(daemon);
    Client stranger(daemon, "you");
    for (Client* client : {&owner, &stranger}) client->receive(frame_of(0, wire::HelloT{}));
    wire::QueryT detached = query_of(0);
    detached.job->detach = true;
    detached.generator = std::make_unique<wire::GeneratorT>();
    detached.generator->kind = "pinhole";
    detached.generator->settings = {"size=8x8", "fx=4"};
    owner.receive(frame_of(1, detached));
    owner.receive(frame_of(2, query_of(1)));  // attached, waits for its ray
    daemon.settle();
    const std::uint64_t kept = daemon.detached.all().begin()->first;
    const std::uint64_t attached = daemon.admission.jobs().begin()->first;
    const auto ask = [](Client& client, std::uint64_t job) {
        wire::WaitT wait;
        wire::FetchT fetch;
        wire::CancelJobT cancel;
        wait.job = fetch.job = cancel.job = job;
        client.receive(frame_of(11, wait));
        client.receive(frame_of(12, fetch));
        client.receive(frame_of(13, cancel));
    };
    daemon.sent.clear();
    ask(stranger, kept);
    CHECK(errors_of(daemon) == std::vector(3, Code::job_unknown));
    CHECK(daemon.detached.all().contains(kept));
    daemon.sent.clear();
    ask(stranger, attached);
    CHECK(errors_of(daemon) == std::vector(3, Code::job_unknown));
    CHECK(daemon.admission.find(attached) != nullptr);
    daemon.sent.clear();
    ask(owner, attached + 1);
    CHECK(errors_of(daemon) == std::vector(3, Code::job_unknown));
    daemon.sent.clear();
    ask(owner, kept);
    daemon.settle();
    ask(owner, attached);
    // An attached job is nothing to wait for or to fetch, and its request hears of the cancel.
    CHECK(errors_of(daemon) == std::vector{Code::job_unknown, Code::job_unknown, Code::cancelled});
    CHECK(daemon.admission.find(attached) == nullptr);
    CHECK(daemon.detached.all().empty());
}

TEST_CASE("each message that a client may send begins a request, or is a part of one") {
    std::set<std::uint16_t> parts;
#define RAYNEST_PART(number, ...) parts.insert(number);
#include "protocol/lists/requests.def"
    for (std::uint16_t type = 0; type < 256; ++type) {
        CAPTURE(type);
        const Request* request = find_request(type);
        CHECK((request != nullptr) == (protocol::sent_by_client(type) && !parts.contains(type)));
        if (request == nullptr) continue;
        CHECK(request->type == static_cast<wire::Message>(type));
        CHECK((request->answer != nullptr));
    }
}

TEST_CASE("a second greeting and an answer end the conversation, an unknown type does not") {
    SmallDaemon daemon;
    protocol::Frame unknown = frame_of(1, wire::PingT{});
    unknown.header.type = 99;
    std::vector<std::pair<protocol::Frame, bool>> cases;
    cases.emplace_back(frame_of(0, wire::HelloT{}), true);
    cases.emplace_back(frame_of(1, wire::DoneT{}), true);
    cases.emplace_back(std::move(unknown), false);
    for (const auto& [frame, closes] : cases) {
        CAPTURE(frame.header.type);
        daemon.sent.clear();
        Client conversation(daemon);
        conversation.receive(frame_of(0, wire::HelloT{}));
        conversation.receive(golden::copy(frame));
        CHECK(conversation.closing() == closes);
        CHECK(errors_of(daemon) == std::vector{closes ? Code::bad_frame : Code::unknown_type});
    }
}

TEST_CASE("a detached query that fails while its rays come tells its client") {
    SmallDaemon daemon;
    Client conversation(daemon);
    conversation.receive(frame_of(0, wire::HelloT{}));
    wire::QueryT query = query_of(2);
    query.job->detach = true;
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
    const std::uint64_t idle_bytes = daemon.used_bytes();
    // Leave out messages of daemons, which would end the conversation at once.
    auto examples = golden::examples();
    std::erase_if(examples, [](const golden::Example& example) {
        return example.name == "Hello" || example.frame.header.type >= 128;
    });
    Random random(20);
    for (int round = 0; round < 1000; ++round) {
        INFO("round ", round);
        daemon.sent.clear();
        Client conversation(daemon);
        protocol::FrameDecoder decoder(daemon.limits);
        conversation.receive(frame_of(0, wire::HelloT{}));
        for (int step = 0; step < 12 && !conversation.closing(); ++step) {
            const auto& example = examples[random.next() % examples.size()];
            std::vector<std::byte> bytes = golden::wire_bytes(example.frame);
            // Half of the frames are damaged somewhere after the header.
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
    CHECK(daemon.used_bytes() == idle_bytes);
    MESSAGE(daemon.metrics.jobs_started.load(), " jobs");
}

}  // namespace
}  // namespace raynest::server
