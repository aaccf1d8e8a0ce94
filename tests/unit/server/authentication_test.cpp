#include "server/security/authentication.h"

#include <doctest/doctest.h>

#include <chrono>
#include <string>

namespace raynest::server {
namespace {

using namespace std::chrono_literals;
using Place = PeerIdentity::Place;
using Steady = std::chrono::steady_clock::time_point;

const WallClock::time_point noon{std::chrono::hours(12)};

/// A daemon with a token of alice, a user, and one of vera, a viewer for an hour.
struct GuardedDaemon {
    AccessPolicy policy{.tokens = true};
    std::string alice = new_token();
    std::string vera = new_token();
    Authentication authentication{policy};
    Steady now{1h};

    GuardedDaemon() { put(rows()); }
    [[nodiscard]] TokenTable rows() const {
        TokenTable table;
        table.put({TokenRow::Kind::token, "alice", Role::user, hash_token(alice), {}, {.jobs = 3}});
        table.put({TokenRow::Kind::token, "vera", Role::viewer, hash_token(vera), noon + 1h, {}});
        table.put({TokenRow::Kind::certificate, "CN=robot", Role::admin, {}, {}, {}});
        return table;
    }
    void put(TokenTable table) { authentication.set_tokens(std::move(table)); }
    Reply<Principal> come(const PeerIdentity& peer, const std::string& token,
                          WallClock::time_point wall = noon) {
        return authentication.identify(peer, token, now, wall);
    }
};

const PeerIdentity stranger{"192.0.2.7", Place::remote, "tls"};

TEST_CASE("a token gives its principal, role and quota, until it expires") {
    GuardedDaemon guarded;
    const auto alice = guarded.come(stranger, guarded.alice);
    REQUIRE(alice);
    CHECK(alice->id == "alice");
    CHECK(alice->role == Role::user);
    CHECK(alice->quota.jobs == 3);
    CHECK(guarded.come(stranger, guarded.vera)->role == Role::viewer);
    CHECK(guarded.come(stranger, guarded.vera, noon + 2h).error().code == Code::not_allowed);
    for (const std::string& wrong :
         {guarded.alice.substr(0, 36), guarded.alice + "0", std::string("rnt_"), new_token()})
        CHECK(guarded.come({"192.0.2." + std::to_string(wrong.size()), Place::remote, "tls"}, wrong)
                  .error()
                  .code == Code::not_allowed);
}

TEST_CASE("a revoked, changed or expired row is no longer valid for open connections") {
    GuardedDaemon guarded;
    const auto alice = guarded.come(stranger, guarded.alice);
    const auto vera = guarded.come(stranger, guarded.vera);
    CHECK(guarded.authentication.still_valid(*alice, noon));
    CHECK(guarded.authentication.still_valid(*vera, noon));
    CHECK_FALSE(guarded.authentication.still_valid(*vera, noon + 2h));
    TokenTable changed = guarded.rows();
    changed.put({TokenRow::Kind::token, "vera", Role::admin, hash_token(guarded.vera), noon + 1h, {}});
    CHECK(changed.erase("alice"));
    guarded.put(changed);
    CHECK_FALSE(guarded.authentication.still_valid(*alice, noon));
    CHECK_FALSE(guarded.authentication.still_valid(*vera, noon));
    CHECK(guarded.authentication.still_valid({"uid:0", {}, Role::admin, ""}, noon));
}

TEST_CASE("an address waits longer after each of many wrong tokens, and others do not") {
    GuardedDaemon guarded;
    for (int i = 0; i < 5; ++i)
        CHECK(guarded.come(stranger, "wrong").error().code == Code::not_allowed);
    const auto busy = guarded.come(stranger, guarded.alice);
    REQUIRE_FALSE(busy);
    CHECK(busy.error().code == Code::busy);
    CHECK(busy.error().retry_after_ms == 250);
    CHECK(guarded.come({"192.0.2.8", Place::remote, "tls"}, guarded.alice));
    guarded.now += 250ms;
    CHECK(guarded.come(stranger, "wrong").error().code == Code::not_allowed);
    CHECK(guarded.come(stranger, guarded.alice).error().retry_after_ms == 500);
    guarded.now += 500ms;
    CHECK(guarded.come(stranger, guarded.alice));
    CHECK(guarded.come(stranger, "wrong").error().code == Code::not_allowed);
}

TEST_CASE("the table of failures is bounded") {
    LoginFailures failures;
    const Steady now{1h};
    for (int i = 0; i < 5; ++i) failures.failed("first", now);
    for (int i = 0; i < 5000; ++i) failures.failed(std::to_string(i), now + 1ms);
    CHECK(failures.wait_of("first", now) == 0ms);
}

TEST_CASE("without a token the transport decides") {
    GuardedDaemon guarded;
    Authentication open;
    AccessPolicy off;
    off.anonymous.reset();
    Authentication closed(off);
    const PeerIdentity root{"uid:0", Place::own_user, "unix"};
    const PeerIdentity other{"uid:1000", Place::other_user, "unix"};
    const PeerIdentity loopback{"127.0.0.1", Place::loopback, "tcp"};
    const PeerIdentity local_tls{"127.0.0.1", Place::loopback, "tls"};
    const auto role = [](Authentication& by, const PeerIdentity& peer) {
        const auto principal = by.identify(peer, "", {}, noon);
        return principal ? std::string(role_name(principal->role)) : "refused";
    };
    CHECK(role(open, root) == "admin");
    CHECK(role(open, other) == "user");
    CHECK(role(open, loopback) == "user");
    CHECK(role(open, local_tls) == "user");
    CHECK(role(closed, root) == "admin");
    CHECK(role(closed, other) == "refused");
    CHECK(role(closed, loopback) == "refused");
    CHECK(role(guarded.authentication, loopback) == "user");
    CHECK(role(guarded.authentication, local_tls) == "refused");
    CHECK(role(guarded.authentication, stranger) == "refused");
    CHECK(role(guarded.authentication, {"192.0.2.7", Place::remote, "tcp"}) == "refused");
}

TEST_CASE("a certificate's subject is the principal, and its row gives the role") {
    GuardedDaemon guarded;
    PeerIdentity peer = stranger;
    peer.subject = "CN=robot";
    CHECK(guarded.come(peer, "")->role == Role::admin);
    peer.subject = "CN=somebody,O=Lab";
    CHECK(guarded.come(peer, "")->role == Role::user);
    CHECK(guarded.come(peer, "")->id == "CN=somebody,O=Lab");
    TokenTable shut = guarded.rows();
    shut.put({TokenRow::Kind::shut_out, "CN=somebody,O=Lab", Role::viewer, {}, {}, {}});
    guarded.put(shut);
    CHECK(guarded.come(peer, "").error().code == Code::not_allowed);
    // A token counts more.
    CHECK(guarded.come(peer, guarded.vera)->id == "vera");
}

}  // namespace
}  // namespace raynest::server
