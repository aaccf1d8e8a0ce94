// LOAD on the io thread: which requests it accepts, and the work of its tasks.
#include "protocol/hash.h"
#include "server/handlers/handler.h"
#include "tests/unit/server/small_daemon.h"

#include <doctest/doctest.h>

#include <algorithm>

namespace raynest::server {
namespace {

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

protocol::Frame piece_of(std::uint64_t bytes) {
    protocol::Bulk bulk;
    bulk.add("data", wire::Dtype::u8, 1, bytes);
    bulk.allocate();
    std::fill_n(bulk.block(0).data(), bytes, std::byte{0});
    return protocol::encode(1, wire::UploadT{}, std::move(bulk)).value();
}

TEST_CASE("an upload reserves the bytes that have come, not those that it announces") {
    SmallDaemon daemon;
    const std::uint64_t before = daemon.budget.used();
    const std::uint64_t most = daemon.budget.limit() - before;
    const auto first = accepted(ask(daemon, upload_of(most)));
    CHECK(ask(daemon, upload_of(most + 1)).error().code == Code::resource_exhausted);
    const auto second = accepted(ask(daemon, upload_of(most), "you"));
    CHECK(daemon.budget.used() == before);
    REQUIRE(first->feed(piece_of(1000)));
    CHECK(daemon.budget.used() == before + 1000);

    // Others reserve most of the budget meanwhile.
    const auto taken = daemon.budget.reserve(most - 1500);
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

}  // namespace
}  // namespace raynest::server
