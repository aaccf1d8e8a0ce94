// Tests memory that runs out at any moment: each script runs repeatedly, and each time one more
// allocation succeeds before one fails. Then only the current request or connection fails: nothing
// crashes, nothing leaks, the client gets an end or the connection ends, and the next client gets
// the usual answer.
#include "server/store/state_folder.h"
#include "tests/golden/examples.h"
#include "tests/sanitized.h"
#include "tests/temporary_folder.h"
#include "tests/unit/server/counted_memory.h"
#include "tests/unit/server/small_daemon.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdlib>
#include <iostream>
#include <new>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace {

constexpr long never = -1;
/// Number of allocations of this thread before the one that fails; only one fails.
thread_local long until_failure = never;

namespace test = raynest::test;

void* allocate(std::size_t size, std::size_t alignment) {
    if (until_failure != never && until_failure-- == 0) throw std::bad_alloc();
    test::largest_bytes = std::max(test::largest_bytes, size);
    test::allocated_bytes += size;
    const std::size_t rounded = (size + alignment) / alignment * alignment;
    if (void* memory = std::aligned_alloc(alignment, rounded)) return memory;
    throw std::bad_alloc();
}

}  // namespace

// Replace the library's own functions for everything in this program.
void* operator new(std::size_t size) {
    return allocate(size, alignof(std::max_align_t));
}
void* operator new(std::size_t size, std::align_val_t alignment) {
    return allocate(size, static_cast<std::size_t>(alignment));
}
// The library's own versions call those above; a sanitizer's take memory of another kind.
void* operator new(std::size_t size, const std::nothrow_t&) noexcept {
    try {
        return operator new(size);
    } catch (const std::bad_alloc&) {
        return nullptr;
    }
}
void* operator new(std::size_t size, std::align_val_t alignment, const std::nothrow_t&) noexcept {
    try {
        return operator new(size, alignment);
    } catch (const std::bad_alloc&) {
        return nullptr;
    }
}
void operator delete(void* memory) noexcept {
    std::free(memory);
}
void operator delete(void* memory, std::size_t) noexcept {
    std::free(memory);
}
void operator delete(void* memory, std::align_val_t) noexcept {
    std::free(memory);
}
void operator delete(void* memory, std::size_t, std::align_val_t) noexcept {
    std::free(memory);
}

namespace raynest::test {
namespace {

using test::frame_of;

constexpr long stride = sanitized ? 7 : 1;  ///< an import child takes half a second
/// Too long for a std::string's internal buffer.
constexpr const char* new_scene = "a scene with a name of some length";
constexpr const char* principal = "a principal with a name of some length";

/// The client's frames after its Hello; the first request has the id 5.
using Script = std::vector<protocol::Frame>;

template <class... Frames>
Script script(Frames... frames) {
    Script script;
    (script.push_back(std::move(frames)), ...);
    return script;
}

std::unique_ptr<wire::JobT> forest_job() {
    auto job = std::make_unique<wire::JobT>();
    job->scene = "forest";
    return job;
}

Script query(const char* kind, std::vector<std::string> fields) {
    wire::QueryT query;
    query.job = forest_job();
    query.kind = kind;
    query.fields = std::move(fields);
    query.ray_count = 2;
    protocol::Bulk bulk;
    bulk.add("rays", wire::Dtype::f32, 8, 2);
    bulk.allocate();
    constexpr std::array<float, 8> ray = {0.5F, 0.5F, 5, 0, 0, 0, -1, 1e30F};
    for (std::size_t i = 0; i < 16; ++i) bulk.block_as<float>(0)[i] = ray[i % 8];
    return script(frame_of(5, query),
                  protocol::encode(5, wire::QueryRaysT{}, std::move(bulk)).value());
}

template <class Picture>
Script picture() {
    Picture picture;
    picture.job = forest_job();
    picture.width = picture.height = 9;
    picture.encode = "raw";
    return script(frame_of(5, picture));
}

Script load() {
    wire::LoadT load;
    load.source = "builtin:terrain?size=2";
    load.name = new_scene;
    return script(frame_of(5, load));
}

template <class Native>
Script about_forest(Native message) {
    message.scene = "forest";
    return script(frame_of(5, message));
}

/// The daemon's answers to a script.
struct Heard {
    bool connection_ended = false;
    bool request_ended = false;
    std::vector<std::pair<std::uint16_t, std::vector<std::byte>>> frames;  ///< type and bulk
};

struct Named {
    const char* name;
    Script script;
};

class Trial {
public:
    Trial() { daemon.services.import_child = {RAYNEST_DAEMON, "--import-child", "auto"}; }

    /// Runs a script in which only allocation `failing` fails, if it is reached.
    Heard run(const Script& script, long failing = never) {
        Script copies;
        copies.push_back(frame_of(0, wire::HelloT{}));
        for (const protocol::Frame& frame : script) copies.push_back(golden::copy(frame));
        daemon.sent.clear();
        Heard heard;
        std::optional<Client> conversation;
        until_failure = failing;
        try {
            conversation.emplace(daemon, principal);
            for (protocol::Frame& frame : copies) conversation->receive(std::move(frame));
            daemon.settle();
        } catch (const std::bad_alloc&) {
            // The exception ends a session's coroutine and so its connection.
            heard.connection_ended = true;
        }
        failed = until_failure == never;
        until_failure = never;
        if (conversation && !heard.connection_ended) CHECK(conversation->runner().size() == 0);
        conversation.reset();
        daemon.settle();
        for (const protocol::Frame& frame : daemon.sent) {
            heard.frames.emplace_back(
                frame.header.type,
                std::vector<std::byte>(frame.bulk.span().begin(), frame.bulk.span().end()));
            const auto type = static_cast<wire::Message>(frame.header.type);
            const bool goes_on = type == wire::Message::Started || type == wire::Message::Chunk ||
                                 type == wire::Message::Payload || type == wire::Message::Welcome;
            heard.request_ended = heard.request_ended || !goes_on;
            const auto error = protocol::open<wire::Error>(frame);
            heard.connection_ended = heard.connection_ended || (error && (*error)->closing());
        }
        return heard;
    }

    SmallDaemon daemon;
    bool failed = false;  ///< did the last run reach its failure?
};

TEST_CASE("an allocation that fails at any moment fails one request or one connection alone") {
    Trial trial;
    SmallDaemon& daemon = trial.daemon;
    const Named scripts[] = {
        {"greeting", {}},
        {"closest", query("closest", {})},
        {"closest, all its columns", query("closest", {"t", "prim", "path", "ng", "uv", "nodes"})},
        {"any", query("any", {})},
        {"multi", query("multi", {"t", "path"})},
        {"render", picture<wire::RenderT>()},
        {"heatmap", picture<wire::HeatmapT>()},
        {"load", load()},
        {"scenes", script(frame_of(5, wire::ScenesT{}))},
        {"info", about_forest(wire::InfoT{})},
        {"path", about_forest(wire::PathT{})},
        {"variants", script(frame_of(5, wire::VariantsT{}))},
        {"stats", script(frame_of(5, wire::StatsT{}))},
    };
    wire::UnloadT unload_message;
    unload_message.scene = new_scene;
    const Script unload = script(frame_of(5, unload_message));
    long failures = 0;
    for (const auto& [name, script] : scripts) {
        INFO(std::string(name));
        const Heard good = trial.run(script);
        trial.run(unload);
        const std::uint64_t idle_bytes = daemon.used_bytes();
        CHECK((script.empty() || good.request_ended));
        for (long n = 0;; n += stride, ++failures) {
            CAPTURE(n);
            const Heard heard = trial.run(script, n);
            if (!trial.failed) break;
            CHECK((heard.connection_ended || heard.request_ended || script.empty()));
            trial.run(unload);
            CHECK(daemon.handlers_failed == 0);
            CHECK(daemon.metrics.jobs_ended.load() == daemon.metrics.jobs_started.load());
            CHECK(daemon.admission.active() == 0);
            CHECK(daemon.used_bytes() == idle_bytes);
            CHECK(trial.run(script).frames == good.frames);
            trial.run(unload);
        }
    }
    CHECK(failures > 400 / stride);
    std::cout << "tally: allocations that fail: " << failures
              << ": one request or connection each\n";
}

/// A peer whose principal is not yet known.
class Newcomer final : public server::Peer {
public:
    [[nodiscard]] const std::string& principal() const override { return address; }
    [[nodiscard]] std::uint64_t holds(server::Resource /*resource*/) const override { return 1; }
    [[nodiscard]] std::optional<server::Clock::time_point> paused_since() const override {
        return std::nullopt;
    }
    void give_way(const protocol::Error& /*why*/) override {}

    const std::string address = "an address with a name of some length";
};

TEST_CASE(
    "a peer whose admission fails at any allocation is counted as a whole, and leaves as one") {
    const protocol::Limits limits;
    server::Metrics metrics;
    server::Budget budget(1 << 20);
    server::Peers peers(limits, budget, metrics);
    long failures = 0;
    for (long n = 0;; ++n, ++failures) {
        CAPTURE(n);
        Newcomer peer;
        until_failure = n;
        try {
            peers.join(peer);
            peers.move(peer, principal);
        } catch (const std::bad_alloc&) {
        }
        const bool failed = until_failure == never;
        until_failure = never;
        // Its principal() is still the address, as when the greeting fails after the move.
        CHECK(peers.size() == peers.size_of(peer.address) + peers.size_of(principal));
        peers.leave(peer);
        CHECK(peers.size() == 0);
        CHECK(peers.size_of(peer.address) + peers.size_of(principal) == 0);
        if (!failed) break;
    }
    CHECK(failures > 3);
}

TEST_CASE("a job whose entry fails at any allocation counts nowhere") {
    const protocol::Limits limits;
    server::Admission admission(limits);
    for (long n = 0;; ++n) {
        CAPTURE(n);
        server::JobRecord record;
        record.principal = principal;
        until_failure = n;
        server::Reply<server::Admission::Slot> slot;
        try {
            slot = admission.enter(std::move(record));
        } catch (const std::bad_alloc&) {
            slot = server::refuse(server::Code::resource_exhausted, "");
        }
        const bool failed = until_failure == never;
        until_failure = never;
        CHECK(admission.active_of(principal) == (slot ? 1 : 0));
        CHECK(admission.active() == (slot ? 1 : 0));
        if (!failed) break;
    }
    CHECK(admission.active() == 0);
}

TEST_CASE("a pin of a stored scene fails at any allocation, and the next one is made") {
    const TemporaryFolder folder;
    const auto state = server::StateFolder::open(folder.path()).value();
    long failures = 0;
    for (bool failed = true; failed; failures += failed ? 1 : 0) {
        // A new one each time, so that each step comes again.
        const std::string digest(64, static_cast<char>('a' + failures));
        until_failure = failures;
        try {
            failed = state->pin(digest) == nullptr;
        } catch (const std::bad_alloc&) {
            failed = true;
        }
        until_failure = never;
        CHECK(state->pin(digest) != nullptr);
    }
    CHECK(failures == 5);
    state->collect();
    CHECK(!state->has_work());
}

TEST_CASE("the tables of a lidar are left to its tasks") {
    SmallDaemon daemon;
    Client conversation(daemon, principal);
    conversation.receive(frame_of(0, wire::HelloT{}));
    wire::QueryT query;
    query.job = forest_job();
    query.generator = std::make_unique<wire::GeneratorT>();
    query.generator->kind = "lidar";
    query.generator->settings = {"elevations=-1", "azimuths=0:360:65536"};
    constexpr std::size_t table_bytes = 65536 * 2 * sizeof(double);
    largest_bytes = 0;
    conversation.receive(frame_of(1, query));
    CHECK(daemon.said(wire::Message::Started));
    CHECK(largest_bytes < table_bytes);
    daemon.settle();
    CHECK(largest_bytes >= table_bytes);
}

}  // namespace
}  // namespace raynest::test
