// The protocol's state machine over plain memory, with whatever a client may send in any order.
#include "server/conversation.h"

#include "engine/math/random.h"
#include "tests/golden/examples.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <condition_variable>
#include <deque>
#include <mutex>

namespace raynest::server {
namespace {

/// A daemon without sockets. Completions of tasks wait until settle() takes them.
class Table final : public Sink {
public:
    Table() {
        auto loaded = Registry::load({});
        if (!loaded) FAIL(loaded.error().message);
        registry = *loaded;
        services.emplace(Services{*registry,
                                  scenes,
                                  budget,
                                  metrics,
                                  limits,
                                  {},
                                  {},
                                  {"/bin/false"},
                                  admission,
                                  detached});
        // What the examples ask about; of another owner, so that none can unload it.
        SceneDescription forest = test::tree_scene();
        forest.cameras.resize(1);
        forest.cameras[0].name = "overview";
        REQUIRE(scenes.publish("forest", test::bake(forest), false, "owner"));
    }

    void send(protocol::Frame frame) override { sent.push_back(std::move(frame)); }
    [[nodiscard]] std::uint64_t backlog() const override { return 0; }

    /// Takes completions until no job runs.
    void settle() {
        while (admission.active() != 0) {
            std::unique_lock lock(mutex);
            const bool came =
                wake.wait_for(lock, std::chrono::seconds(20), [&] { return !posted.empty(); });
            REQUIRE(came);
            const auto next = std::move(posted.front());
            posted.pop_front();
            lock.unlock();
            next();
        }
    }
    [[nodiscard]] bool said(wire::Message type) const {
        return std::any_of(sent.begin(), sent.end(), [&](const protocol::Frame& frame) {
            return frame.header.type == static_cast<std::uint16_t>(type);
        });
    }

    std::shared_ptr<const Registry> registry;
    protocol::Limits limits;
    Metrics metrics;
    Budget budget{1 << 26};
    SceneStore scenes{budget};
    Admission admission{64};
    BriefTurn brief_turn;
    std::vector<protocol::Frame> sent;
    std::mutex mutex;
    std::condition_variable wake;
    std::deque<std::function<void()>> posted;
    std::optional<Services> services;
    Workers compute{2};
    Workers blocking{1};
    Engine engine{compute,
                  blocking,
                  admission,
                  metrics,
                  limits,
                  [this](std::function<void()> done) {
                      const std::lock_guard lock(mutex);
                      posted.push_back(std::move(done));
                      wake.notify_all();
                  },
                  budget,
                  brief_turn};
    DetachedJobs detached{engine, [] {}};
};

template <class Native>
protocol::Frame frame_of(std::uint64_t id, const Native& message) {
    return protocol::encode(id, message).value();
}

TEST_CASE("nothing but a greeting opens a conversation") {
    Table table;
    for (const golden::Example& example : golden::examples()) {
        table.sent.clear();
        Conversation conversation(*table.services, table.engine, table, "me");
        protocol::Frame frame;
        frame.header = example.frame.header;
        frame.control = protocol::Buffer(example.frame.control.size());
        std::copy_n(example.frame.control.data(), frame.control.size(), frame.control.data());
        conversation.receive(std::move(frame));
        CHECK(conversation.greeted() == (example.name == "Hello"));
        CHECK(conversation.closing() == (example.name != "Hello"));
        CHECK(table.sent.size() == 1);
    }
}

TEST_CASE("a draining conversation answers questions, refuses jobs and ends with the last one") {
    Table table;
    Conversation conversation(*table.services, table.engine, table, "me");
    conversation.receive(frame_of(0, wire::HelloT{}));
    wire::QueryT query;
    query.job = std::make_unique<wire::JobT>();
    query.job->scene = "forest";
    query.ray_count = 1;
    conversation.receive(frame_of(1, query));
    CHECK(table.said(wire::Message::Started));
    conversation.drain();
    CHECK_FALSE(conversation.closing());
    conversation.receive(frame_of(2, wire::VariantsT{}));
    CHECK(table.said(wire::Message::VariantList));
    conversation.receive(frame_of(3, query));
    CHECK(table.said(wire::Message::Error));
    conversation.receive(frame_of(1, wire::CancelT{}));
    CHECK(conversation.closing());
}

TEST_CASE(
    "a detached query runs on when its rays have come, and ends with its client before that") {
    Table table;
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
        table.sent.clear();
        {
            Conversation conversation(*table.services, table.engine, table, "me");
            conversation.receive(frame_of(0, wire::HelloT{}));
            conversation.receive(frame_of(1, query));
            conversation.receive(rays(0));
            CHECK_FALSE(table.said(wire::Message::Detached));
            if (all) conversation.receive(rays(1));
            CHECK(table.said(wire::Message::Detached) == all);
            // The id is free again, and what was detached is not this connection's any more.
            if (all) conversation.receive(frame_of(1, wire::CancelT{}));
        }
        table.settle();
        CHECK(table.detached.all().size() == (all ? 1 : 0));
        CHECK_FALSE(table.said(wire::Message::Chunk));
        CHECK_FALSE(table.said(wire::Message::Error));
    }
    const auto& job = *table.detached.all().begin()->second;
    CHECK(job.ended());
    CHECK_FALSE(job.error());
    CHECK(job.answer().front().header.type == static_cast<std::uint16_t>(wire::Message::Started));
}

TEST_CASE("a detached query that goes wrong while its rays come tells its client") {
    Table table;
    Conversation conversation(*table.services, table.engine, table, "me");
    conversation.receive(frame_of(0, wire::HelloT{}));
    wire::QueryT query;
    query.job = std::make_unique<wire::JobT>();
    query.job->scene = "forest";
    query.job->detach = true;
    query.ray_count = 2;
    conversation.receive(frame_of(1, query));
    conversation.receive(frame_of(1, wire::QueryRaysT{}));  // without its block
    CHECK(table.said(wire::Message::Error));
    CHECK_FALSE(table.said(wire::Message::Detached));
    table.sent.clear();
    conversation.receive(frame_of(1, query));
    CHECK_FALSE(table.said(wire::Message::Error));
    conversation.receive(frame_of(1, wire::CancelT{}));
    CHECK(table.said(wire::Message::Error));
    CHECK(table.admission.active() == 0);
}

TEST_CASE("whatever frames come in whatever order, all jobs end and all memory returns") {
    Table table;
    const std::uint64_t idle_bytes = table.budget.used();
    // What only a daemon says would end the conversation at once.
    auto examples = golden::examples();
    std::erase_if(examples, [](const golden::Example& example) {
        return example.name == "Hello" || example.frame.header.type >= 128;
    });
    Random random(20);
    for (int round = 0; round < 1000; ++round) {
        INFO("round ", round);
        table.sent.clear();
        Conversation conversation(*table.services, table.engine, table, "me");
        protocol::FrameDecoder decoder(table.limits);
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
        table.detached.stop_running();
        table.settle();
        const auto kept = table.detached.all();
        for (const auto& [number, job] : kept) table.detached.cancel(number);
        CHECK(table.metrics.jobs_started == table.metrics.jobs_ended);
    }
    CHECK(table.budget.used() == idle_bytes);
    MESSAGE(table.metrics.jobs_started.load(), " jobs");
}

}  // namespace
}  // namespace raynest::server
