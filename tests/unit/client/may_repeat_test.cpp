#include "client/commands/may_repeat.h"

#include <doctest/doctest.h>

using namespace raynest::client;

namespace {

bool may_repeat(const CommandOptions& command) {
    return raynest::client::may_repeat(command, lost(Exit::failed, "gone"), false);
}

}  // namespace

TEST_CASE("a command whose request acts runs once") {
    CHECK(!may_repeat(GcOptions{}));
    CHECK(!may_repeat(AdminOptions{}));
    CHECK(!may_repeat(CancelOptions{}));
    CHECK(!may_repeat(EditOptions{}));
    CHECK(!may_repeat(UnloadOptions{}));
    CHECK(!may_repeat(RestoreOptions{}));
    CHECK(!may_repeat(OpenOptions{}));
}

TEST_CASE("so does one that acts without a request") {
    CHECK(!may_repeat(LoginOptions{}));
    CHECK(!may_repeat(LogoutOptions{}));
}

TEST_CASE("a command that asks runs again where its daemon is lost, and nowhere else") {
    CHECK(may_repeat(ScenesOptions{}));
    CHECK(may_repeat(StatsOptions{}));
    InfoOptions info;
    info.scene = "forest";
    CHECK(may_repeat(info));
    CHECK(!raynest::client::may_repeat(info, failure(Exit::busy, "full"), false));
    CHECK(!raynest::client::may_repeat(info, lost(Exit::failed, "gone"), true));
}
