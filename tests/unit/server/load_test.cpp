// LOAD as the io thread sees it: what it accepts, and what its tasks do.
#include "server/handlers/handler.h"
#include "tests/unit/server/small_daemon.h"

#include <doctest/doctest.h>

namespace raynest::server {
namespace {

using test::SmallDaemon;

Reply<Answer> ask(SmallDaemon& daemon, const wire::LoadT& message,
                  const std::string& principal = "me") {
    const auto frame = protocol::encode(1, message, daemon.limits).value();
    const auto opened = protocol::open<wire::Load>(frame, daemon.limits);
    REQUIRE(opened);
    return load(daemon.services, {principal, 1, 1 << 20}, *opened);
}

std::unique_ptr<Job> accepted(Reply<Answer> answer) {
    REQUIRE_MESSAGE(answer, (answer ? "" : answer.error().message));
    return std::move(std::get<Accepted>(*answer).job);
}

/// A client that loses interest once it was asked for a few times.
class Impatient final : public Stop {
public:
    [[nodiscard]] bool requested() const noexcept override { return ++asked_ > 3; }

private:
    mutable int asked_ = 0;
};

TEST_CASE("a load that nobody waits for ends its import process and frees its thread") {
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
