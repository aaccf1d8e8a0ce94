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

TEST_CASE("wrong tokens of an address wait longer after each, and right ones do not") {
    GuardedDaemon guarded;
    for (int i = 0; i < 5; ++i)
        CHECK(guarded.come(stranger, "wrong").error().code == Code::not_allowed);
    const auto busy = guarded.come(stranger, "wrong");
    REQUIRE_FALSE(busy);
    CHECK(busy.error().code == Code::busy);
    CHECK(busy.error().retry_after_ms == 250);
    CHECK(guarded.come({"192.0.2.8", Place::remote, "tls"}, "wrong").error().code ==
          Code::not_allowed);
    guarded.now += 250ms;
    CHECK(guarded.come(stranger, "wrong").error().code == Code::not_allowed);
    CHECK(guarded.come(stranger, "wrong").error().retry_after_ms == 500);
    // Another program behind the same address has a right one.
    CHECK(guarded.come(stranger, guarded.alice));
    CHECK(guarded.come(stranger, "wrong").error().code == Code::not_allowed);
}

TEST_CASE("a token that was right waits as any wrong one") {
    GuardedDaemon guarded;
    for (int i = 0; i < 5; ++i) (void)guarded.come(stranger, "wrong");
    const auto unknown = guarded.come(stranger, "wrong").error();
    const auto expired = guarded.come(stranger, guarded.vera, noon + 2h).error();
    CHECK(expired.code == Code::busy);
    CHECK(expired.message == unknown.message);
    CHECK(expired.retry_after_ms == unknown.retry_after_ms);
}

TEST_CASE("a certificate whose subject names nobody is told why") {
    GuardedDaemon guarded;
    PeerIdentity peer = stranger;
    peer.subject_fault = "is over 200 bytes";
    const auto refused = guarded.come(peer, "");
    REQUIRE_FALSE(refused);
    CHECK(refused.error().code == Code::not_allowed);
    CHECK(refused.error().message.find("certificate is over 200 bytes") != std::string::npos);
    CHECK(guarded.come(peer, guarded.alice)->id == "alice");
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

// ---- the page

/// An https connection from another machine.
const PeerIdentity browser{"192.0.2.9", Place::remote, "https"};

TEST_CASE("a token begins a login of the page, whose cookie is its principal") {
    GuardedDaemon guarded;
    Authentication& daemon = guarded.authentication;
    const auto secret = daemon.log_in(browser, guarded.alice, "", guarded.now, noon);
    REQUIRE(secret);
    CHECK(secret->size() == 64);
    const auto ask = [&](std::string_view bearer, std::string_view cookie) {
        return daemon.identify_request(browser, bearer, cookie, guarded.now, noon);
    };
    CHECK(ask("", *secret)->id == "alice");
    CHECK(ask("", *secret)->page_login != 0);
    CHECK(ask(guarded.vera, *secret)->id == "vera");
    for (const std::string& wrong : {std::string(), new_secret(), secret->substr(1)})
        CHECK(ask("", wrong).error().code == Code::not_allowed);
    // The WebSocket of that page needs no token.
    PeerIdentity page = browser;
    page.sender = std::make_shared<const Principal>(*ask("", *secret));
    CHECK(guarded.come(page, "")->id == "alice");
    CHECK(daemon.still_valid(*page.sender, noon));
    CHECK(daemon.logins().end(*secret));
    CHECK_FALSE(daemon.still_valid(*page.sender, noon));
    CHECK(guarded.come(page, "").error().code == Code::not_allowed);
    CHECK(ask("", *secret).error().code == Code::not_allowed);
}

TEST_CASE("a login ends with the row of its token, and after its time") {
    GuardedDaemon guarded;
    Authentication& daemon = guarded.authentication;
    const auto alice = daemon.log_in(browser, guarded.alice, "", guarded.now, noon);
    const auto vera = daemon.log_in(browser, guarded.vera, "", guarded.now, noon);
    REQUIRE(alice);
    REQUIRE(vera);
    const auto knows = [&](const std::string& cookie, WallClock::time_point wall) {
        return daemon.identify_request(browser, "", cookie, guarded.now, wall).has_value();
    };
    CHECK(knows(*vera, noon + 59min));
    CHECK_FALSE(knows(*vera, noon + 61min));
    TokenTable table = guarded.rows();
    table.erase("alice");
    guarded.put(std::move(table));
    CHECK_FALSE(knows(*alice, noon));
    guarded.put(guarded.rows());
    CHECK(knows(*alice, noon + 11h));
    CHECK_FALSE(knows(*alice, noon + 13h));
    CHECK(daemon.logins().expire(noon + 13h));
    CHECK_FALSE(daemon.logins().expire(noon + 13h));
}

TEST_CASE("a code logs in once, in time, and as its caller") {
    GuardedDaemon guarded;
    Authentication& daemon = guarded.authentication;
    const Principal caller{"uid:0", {}, Role::admin};
    const auto log_in = [&](const std::string& code, WallClock::time_point wall) {
        return daemon.log_in(browser, "", code, guarded.now, wall);
    };
    const std::string code = daemon.logins().make_code(caller, noon);
    const auto secret = log_in(code, noon + 1min);
    REQUIRE(secret);
    const auto known = daemon.identify_request(browser, "", *secret, guarded.now, noon);
    CHECK(known->id == "uid:0");
    CHECK(known->role == Role::admin);
    CHECK(log_in(code, noon + 1min).error().code == Code::not_allowed);
    CHECK(log_in(daemon.logins().make_code(caller, noon), noon + 3min).error().code ==
          Code::not_allowed);
    CHECK(log_in("", noon).error().code == Code::not_allowed);
}

TEST_CASE("wrong tokens and codes of a page make its address wait") {
    GuardedDaemon guarded;
    Authentication& daemon = guarded.authentication;
    for (int i = 0; i < 5; ++i)
        CHECK(daemon.log_in(browser, i % 2 == 0 ? "wrong" : "", "wrong", guarded.now, noon)
                  .error()
                  .code == Code::not_allowed);
    CHECK(daemon.log_in(browser, "wrong", "", guarded.now, noon).error().code == Code::busy);
    CHECK(daemon.log_in(browser, "", "wrong", guarded.now, noon).error().code == Code::busy);
    CHECK(daemon.identify_request(browser, "wrong", "", guarded.now, noon).error().code ==
          Code::busy);
    CHECK(guarded.come({"192.0.2.9", Place::remote, "tls"}, "wrong").error().code == Code::busy);
    CHECK(daemon.identify_request(browser, guarded.vera, "", guarded.now, noon)->id == "vera");
    CHECK(daemon.log_in(browser, guarded.alice, "", guarded.now, noon));
}

TEST_CASE("the oldest code gives way when there are too many") {
    PageLogins logins;
    const Principal caller{"me", {}, Role::user};
    const std::string first = logins.make_code(caller, noon);
    std::string last;
    for (int i = 0; i < 256; ++i) last = logins.make_code(caller, noon + 1s);
    CHECK_FALSE(logins.take_code(first, noon + 1s));
    CHECK(logins.take_code(last, noon + 1s));
}

}  // namespace
}  // namespace raynest::server
