// A connection is closed to make room for others, never to make room for its own requests.
#include "server/jobs/change_gate.h"
#include "tests/unit/server/bench.h"
#include "tests/unit/server/small_daemon.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace raynest::server {
namespace {

using test::Client;
using test::errors_of;
using test::frame_of;
using test::SmallDaemon;

/// Stands in for a client's connection, and keeps what it would answer to who looks for memory.
class Connection final : public Peer {
public:
    explicit Connection(const Client& client) : client_(client) {}
    [[nodiscard]] const std::string& principal() const override { return principal_; }
    [[nodiscard]] std::uint64_t holds(Resource /*resource*/) const override { return 1; }
    [[nodiscard]] std::optional<Clock::time_point> paused_since() const override {
        may_give_way.push_back(client_.waits_for_client());
        return std::nullopt;
    }
    void give_way(const protocol::Error& /*why*/) override {}

    mutable std::vector<bool> may_give_way;

private:
    const std::string principal_ = "me";
    const Client& client_;
};

TEST_CASE("a connection does not give way to what it goes on with") {
    SmallDaemon daemon;
    ChangeGate gate;
    daemon.services.changes = &gate;
    gate.close();
    Client client(daemon);
    client.receive(frame_of(0, wire::HelloT{}));
    wire::LoadT load;
    load.source = "a.gltf";
    load.file_names = {"a.gltf"};
    load.file_hashes = {1};
    load.file_bytes = {1 << 20};
    client.receive(frame_of(1, load));
    Connection connection(client);
    daemon.peers.join(connection);
    const auto rest = daemon.budget.reserve(daemon.budget.limit() - daemon.budget.used());
    gate.open([](const std::function<void()>& next) { next(); });
    CHECK(errors_of(daemon) == std::vector{Code::resource_exhausted});
    CHECK_FALSE(connection.may_give_way.empty());
    CHECK(std::ranges::count(connection.may_give_way, true) == 0);
    CHECK(client.waits_for_client());
}

/// Says of each step whether its connection could give way meanwhile.
class WatchedJob final : public Job {
public:
    WatchedJob(const Runner& runner, std::vector<bool>& may_give_way)
        : runner_(runner),
          may_give_way_(may_give_way) {}
    std::optional<Task> prepare() override { return see(), std::nullopt; }
    Frames greeting() override { return see(), Frames(); }
    Reply<std::uint64_t> feed(protocol::Frame /*frame*/) override {
        see();
        fed_ = true;
        return 0;
    }
    std::optional<Task> next() override { return see(), std::nullopt; }
    [[nodiscard]] bool needs_input() const override { return !fed_; }
    [[nodiscard]] bool finished() const override { return fed_; }
    Frames farewell() override { return see(), Frames(); }

private:
    void see() { may_give_way_.push_back(runner_.waits_for_client()); }

    const Runner& runner_;
    std::vector<bool>& may_give_way_;
    bool fed_ = false;
};

TEST_CASE("no step of a job may take the memory of its own connection") {
    Bench bench;
    std::vector<bool> may_give_way;
    // The memory for its data and answers is had before it begins.
    auto rest = bench.budget.reserve(bench.budget.limit());
    bench.peers.set_spares([&] {
        may_give_way.push_back(bench.runner->waits_for_client());
        if (rest) rest->shrink(0);
    });
    JobSubmission submission = accept(std::make_unique<WatchedJob>(*bench.runner, may_give_way));
    submission.input_bytes = 1;
    REQUIRE(bench.runner->start(1, std::move(submission)));
    CHECK(bench.runner->waits_for_client());
    bench.runner->feed(*protocol::encode(1, wire::UploadT{}));
    CHECK(bench.runner->size() == 0);
    CHECK(may_give_way == std::vector<bool>(7, false));
}

}  // namespace
}  // namespace raynest::server
