// LOAD on the io thread: which requests it accepts, and the work of its tasks.
#include "protocol/hash.h"
#include "protocol/openssl.h"
#include "server/requests/request.h"
#include "tests/sanitized.h"
#include "tests/unit/server/small_daemon.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <string>
#include <thread>

namespace raynest::server {
namespace {

using test::piece_of;
using test::SmallDaemon;

Reply<Answer> ask(SmallDaemon& daemon, const wire::LoadT& message,
                  const std::string& principal = "me") {
    const auto frame = protocol::encode(1, message, daemon.limits).value();
    const auto opened = protocol::open<wire::Load>(frame, daemon.limits);
    REQUIRE(opened);
    return load(daemon.services, {{principal, 1}, 1, 1 << 20}, *opened);
}

std::unique_ptr<Job> accepted(Reply<Answer> answer) {
    REQUIRE_MESSAGE(answer, (answer ? "" : answer.error().message));
    return std::move(std::get<JobSubmission>(*answer).job);
}

/// A stop flag that is set after a few calls.
class Impatient final : public Stop {
public:
    [[nodiscard]] bool requested() const noexcept override { return ++asked_ > 3; }

private:
    mutable int asked_ = 0;
};

/// Returns an upload of one file of zeros.
wire::LoadT upload_of(std::uint64_t bytes) {
    const std::vector<std::byte> zeros(bytes);
    wire::LoadT message;
    message.source = "a.glb";
    message.file_names = {"a.glb"};
    message.file_hashes = {protocol::upload_checksum(zeros)};
    message.file_bytes = {bytes};
    return message;
}

TEST_CASE("an upload reserves the bytes that have come, not those that it announces") {
    SmallDaemon daemon;
    const std::uint64_t before = daemon.budget.used();
    const std::uint64_t most = daemon.budget.room("me", Use::lasting);
    const auto first = accepted(ask(daemon, upload_of(most)));
    CHECK(ask(daemon, upload_of(most + 1)).error().code == Code::resource_exhausted);
    const auto second = accepted(ask(daemon, upload_of(most), "you"));
    CHECK(daemon.budget.used() == before);
    REQUIRE(first->feed(piece_of(1000)));
    CHECK(daemon.budget.used() == before + 1000);

    // Others reserve most of the budget meanwhile.
    const auto taken = daemon.budget.reserve(daemon.budget.limit() - daemon.budget.used() - 500);
    const auto refused = second->feed(piece_of(1000));
    REQUIRE_FALSE(refused);
    CHECK(refused.error().code == Code::resource_exhausted);
    CHECK(refused.error().message.find("--memory") != std::string::npos);
}

TEST_CASE("a file that does not have the hash that was announced is not imported") {
    SmallDaemon daemon;
    daemon.services.import_child = {"false"};
    wire::LoadT message = upload_of(1000);
    message.file_hashes[0] ^= 1;
    const auto job = accepted(ask(daemon, message));
    REQUIRE(job->feed(piece_of(1000)));
    const StopFlag stop(Clock::time_point::max());
    const auto ended = job->next()->run(stop);
    REQUIRE_FALSE(ended);
    CHECK(ended.error().code == Code::scene_invalid);
    CHECK(ended.error().message.find("a.glb") != std::string::npos);
}

TEST_CASE("a file that does not have the digest that was announced is not imported") {
    SmallDaemon daemon;
    daemon.services.import_child = {"false"};
    wire::LoadT message = upload_of(1000);
    message.file_hashes.clear();
    protocol::Sha256 sum;
    sum.add(std::vector<std::byte>(1000));
    const auto digest = sum.digest();
    message.file_digests.assign(digest->begin(), digest->end());
    const StopFlag stop(Clock::time_point::max());
    for (const bool damaged : {false, true}) {
        message.file_digests[5] ^= damaged ? 1 : 0;
        const auto job = accepted(ask(daemon, message));
        CHECK(job->greeting().size() == 1);  // no scene is made of it: it is wanted
        REQUIRE(job->feed(piece_of(1000)));
        const auto ended = job->next()->run(stop);
        REQUIRE_FALSE(ended);
        CHECK((ended.error().message.find("was damaged on its way") != std::string::npos) ==
              damaged);
    }
}

TEST_CASE("the copy of the files that an import gets is reserved too") {
    SmallDaemon daemon;
    daemon.services.import_child = {"false"};
    const auto job = accepted(ask(daemon, upload_of(1000)));
    REQUIRE(job->feed(piece_of(1000)));
    auto task = job->next();
    REQUIRE(task);
    const StopFlag stop(Clock::time_point::max());
    {
        const auto taken =
            daemon.budget.reserve(daemon.budget.limit() - daemon.budget.used() - 500);
        CHECK(task->run(stop).error().code == Code::resource_exhausted);
    }
    CHECK(task->run(stop).error().code == Code::internal);
}

TEST_CASE("an abandoned load ends its import process and frees its thread") {
    SmallDaemon daemon;
    daemon.services.import_child = {"sleep", "1000"};
    wire::LoadT message;
    message.source = "builtin:flake";
    const auto job = accepted(ask(daemon, message));
    const auto ended = job->next()->run(Impatient());
    REQUIRE_FALSE(ended);
    CHECK(ended.error().code == Code::cancelled);
}

/// A load of a built-in scene by a real child.
std::unique_ptr<Job> load_of(SmallDaemon& daemon, const char* source) {
    daemon.services.import_child = {RAYNEST_TEST_IMPORT_CHILD, "--import-child"};
    wire::LoadT message;
    message.source = source;
    return accepted(ask(daemon, message));
}

TEST_CASE("an import that takes more memory than its principal may have is ended") {
    SmallDaemon daemon;
    const std::uint64_t before = daemon.budget.used();
    // Its scene would fit; what building it takes does not.
    auto job = load_of(daemon, "builtin:terrain");
    const StopFlag stop(Clock::time_point::max());
    const auto ended = job->next()->run(stop);
    REQUIRE_FALSE(ended);
    CHECK(ended.error().code == Code::resource_exhausted);
    CHECK(ended.error().message.starts_with("the import takes "));
    CHECK(ended.error().message.find("me may take now") != std::string::npos);
    job.reset();
    CHECK(daemon.budget.used() == before);
}

TEST_CASE("an import takes memory while it runs, and afterwards that of its scene") {
    SmallDaemon daemon;
    const std::uint64_t before = daemon.budget.used();
    const auto job = load_of(daemon, "builtin:terrain?size=64");
    const StopFlag stop(Clock::time_point::max());
    REQUIRE(job->next()->run(stop));
    const std::uint64_t with_scene = daemon.budget.used();
    CHECK(with_scene > before);
    REQUIRE(job->ended());
    CHECK(daemon.budget.used() == with_scene);
    CHECK(daemon.budget.held_by("me") == with_scene - before);
}

/// A connection that reads nothing.
class PausedPeer final : public Peer {
public:
    PausedPeer(Peers& peers, Budget::Lease lease) : peers_(peers), lease_(std::move(lease)) {
        peers_.join(*this);
    }
    ~PausedPeer() { peers_.leave(*this); }
    [[nodiscard]] const std::string& principal() const override { return name_; }
    [[nodiscard]] std::uint64_t holds(Resource /*resource*/) const override {
        return lease_.bytes();
    }
    [[nodiscard]] std::optional<Clock::time_point> paused_since() const override {
        return Clock::time_point();
    }
    void give_way(const protocol::Error& /*why*/) override {
        lease_ = {};
        gave_way = true;
    }
    bool gave_way = false;

private:
    Peers& peers_;
    const std::string name_ = "you";
    Budget::Lease lease_;
};

TEST_CASE("an upload that is announced and does not come ends nobody's connection") {
    SmallDaemon daemon;
    PausedPeer paused(daemon.peers, daemon.budget.reserve(36 << 20, "you").value());
    const std::uint64_t room = daemon.budget.room("me", Use::lasting);
    const auto job = accepted(ask(daemon, upload_of(room + 1)));
    CHECK_FALSE(paused.gave_way);
    REQUIRE(job->feed(piece_of(1000)));
    CHECK_FALSE(paused.gave_way);
}

TEST_CASE("stored scenes make room for an upload as it comes, not for what it announces") {
    SmallDaemon daemon;
    const std::uint64_t bytes = test::square(1)->bytes().size();
    const ConnectionId alice{"alice", daemon.scenes.connect()};
    for (std::uint64_t number = 1; number <= 8; ++number) {
        const std::string name = std::to_string(number);
        const auto scene = test::square(static_cast<float>(number));
        Publication how;
        how.blob = std::make_shared<const std::string>(scene->arena_id());
        how.row = {.number = number,
                   .owner = "alice",
                   .name = name,
                   .digest = scene->arena_id(),
                   .epoch = 1,
                   .bytes = bytes};
        REQUIRE(daemon.scenes.publish(name, scene, how, alice));
    }
    const auto asleep = [&] { return daemon.scenes.asleep_of("alice"); };
    const std::uint64_t reserve = daemon.budget.limit() / Budget::reserve_part;
    const auto taken = daemon.budget.reserve(
        daemon.budget.room("", Use::lasting) - reserve - 5 * bytes, "", Use::lasting);
    REQUIRE(taken);
    const auto announce = [&](std::uint64_t total) {
        wire::LoadT message = upload_of(0);
        message.file_bytes = {total};
        return ask(daemon, message, "eve");
    };
    REQUIRE(daemon.budget.room("eve", Use::lasting) < 8 * bytes);
    for (const std::uint64_t total : {12 * bytes, std::uint64_t{1} << 32})
        CHECK(announce(total).error().code == Code::resource_exhausted);
    CHECK(asleep() == 0);
    const auto job = accepted(announce(8 * bytes));
    CHECK(asleep() == 0);
    REQUIRE(job->feed(piece_of(8 * bytes)));
    CHECK(asleep() > 0);
    CHECK(asleep() < 8);
}

TEST_CASE("connections that pause give way while an import grows") {
    if (test::imports_grow) return;
    SmallDaemon daemon;
    PausedPeer paused(daemon.peers, daemon.budget.reserve(36 << 20, "you").value());
    const auto job = load_of(daemon, "builtin:terrain?size=300");
    const StopFlag stop(Clock::time_point::max());
    auto task = job->next();
    std::atomic<bool> over = false;
    std::string fault;
    std::thread importer([&] {
        if (const auto done = task->run(stop); !done) fault = done.error().message;
        over = true;
    });
    while (!over) {
        CHECK_FALSE(job->next());
        std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    importer.join();
    CHECK(fault.empty());
    CHECK(paused.gave_way);
}

}  // namespace
}  // namespace raynest::server
