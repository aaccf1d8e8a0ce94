#include "server/security/authentication.h"

#include "server/security/tls_context.h"

#include <doctest/doctest.h>

#include <chrono>
#include <functional>
#include <memory>
#include <string>
#include <vector>

namespace raynest::server {
namespace {

using namespace std::chrono_literals;
using Place = PeerIdentity::Place;
using Steady = std::chrono::steady_clock::time_point;

const WallClock::time_point noon{std::chrono::hours(12)};

/// A daemon with a token of alice, a user, and one of vera, a viewer for an hour.
struct GuardedDaemon {
    AccessPolicy policy{.tokens = true, .certificates = true};
    std::string alice = new_token();
    std::string vera = new_token();
    Authentication authentication{policy};
    Steady now{1h};

    bool trusts_certificates = true;

    GuardedDaemon() {
        put(rows());
        authentication.set_trust(
            [this](const ClientCertificate& shown, WallClock::time_point wall) {
                return trusts_certificates && wall < shown.expires;
            });
    }
    GuardedDaemon(const GuardedDaemon&) = delete;
    [[nodiscard]] TokenTable rows() const {
        TokenTable table;
        table.put({TokenRow::Kind::token, "alice", Role::user, hash_token(alice), {}, {.jobs = 3}});
        table.put({TokenRow::Kind::token, "vera", Role::viewer, hash_token(vera), noon + 1h, {}});
        table.put({TokenRow::Kind::certificate, "CN=robot", Role::admin, {}, {}, {}});
        return table;
    }
    void put(TokenTable table) {
        authentication.set_tokens(std::make_shared<const TokenTable>(std::move(table)));
    }
    Reply<Principal> come(const PeerIdentity& peer, const std::string& token,
                          WallClock::time_point wall = noon) {
        return authentication.identify(peer, token, now, wall);
    }
};

const PeerIdentity stranger{"192.0.2.7", Place::remote, "tls"};

/// A stranger whose certificate ends tomorrow at noon.
PeerIdentity holder(const std::string& subject) {
    PeerIdentity peer = stranger;
    peer.subject = subject;
    peer.certificate =
        std::make_shared<const ClientCertificate>(ClientCertificate{{}, noon + 24h, nullptr});
    return peer;
}

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
    changed.put(
        {TokenRow::Kind::token, "vera", Role::admin, hash_token(guarded.vera), noon + 1h, {}});
    CHECK(changed.erase("alice"));
    guarded.put(changed);
    CHECK_FALSE(guarded.authentication.still_valid(*alice, noon));
    CHECK_FALSE(guarded.authentication.still_valid(*vera, noon));
    CHECK(guarded.authentication.still_valid({"uid:0", {}, Role::admin, ""}, noon));
}

TEST_CASE("each kind of admission is valid only while its rule admits it again") {
    GuardedDaemon guarded;
    Authentication& daemon = guarded.authentication;
    struct Admitted {
        const char* name;
        PeerIdentity peer;
        std::string token;
    };
    const Admitted admitted[] = {
        {"token", stranger, guarded.alice},
        {"certificate with a row", holder("CN=robot"), ""},
        {"certificate alone", holder("CN=somebody"), ""},
        {"plain loopback", {"127.0.0.1", Place::loopback, "tcp"}, ""},
        {"another user of the machine", {"uid:9", Place::other_user, "unix"}, ""},
        {"the daemon's user", {"uid:0", Place::own_user, "unix"}, ""},
    };
    struct Change {
        const char* name;
        std::function<void(GuardedDaemon&)> act;
        std::string stay;  ///< a letter for each of those above; '-' where it must go
    };
    const auto policy = [](auto set) {
        return [set](GuardedDaemon& changed) {
            AccessPolicy now = changed.policy;
            set(now);
            changed.authentication.set_policy(now);
        };
    };
    const auto row = [](TokenRow added) {
        return [added](GuardedDaemon& changed) {
            TokenTable table = changed.rows();
            table.put(added);
            changed.put(std::move(table));
        };
    };
    using Kind = TokenRow::Kind;
    const Change changes[] = {
        {"none", [](GuardedDaemon&) {}, "tcclou"},
        {"the rows were read again", [](GuardedDaemon& g) { g.put(g.rows()); }, "tcclou"},
        {"no rows", [](GuardedDaemon& g) { g.put({}); }, "--clou"},
        {"another token", row({Kind::token, "alice", Role::user, hash_token("x"), {}, {.jobs = 3}}),
         "-cclou"},
        {"another role", row({Kind::certificate, "CN=robot", Role::user, {}, {}, {}}), "t-clou"},
        {"a row that shuts out", row({Kind::shut_out, "CN=somebody", Role::user, {}, {}, {}}),
         "tc-lou"},
        {"a row with a role", row({Kind::certificate, "CN=somebody", Role::viewer, {}, {}, {}}),
         "tc-lou"},
        {"another CA", [](GuardedDaemon& g) { g.trusts_certificates = false; }, "t--lou"},
        {"no CA", policy([](AccessPolicy& p) { p.certificates = false; }), "t--lou"},
        {"no tokens", policy([](AccessPolicy& p) { p.tokens = false; }), "-cclou"},
        {"nobody anonymous", policy([](AccessPolicy& p) { p.anonymous.reset(); }), "tcc--u"},
        {"anonymous viewers", policy([](AccessPolicy& p) { p.anonymous = Role::viewer; }),
         "tcc--u"},
    };
    for (const Change& change : changes) {
        INFO(std::string(change.name));
        GuardedDaemon fresh;
        // The tokens of both daemons are the same.
        fresh.alice = guarded.alice;
        fresh.vera = guarded.vera;
        fresh.put(fresh.rows());
        std::vector<Principal> principals;
        for (const Admitted& one : admitted)
            principals.push_back(fresh.come(one.peer, one.token).value());
        change.act(fresh);
        std::size_t i = 0;
        for (const Admitted& one : admitted) {
            INFO(std::string(one.name));
            const bool stays = change.stay[i] != '-';
            CHECK(fresh.authentication.still_valid(principals[i], noon) == stays);
            // A code and a cookie end with what let their principal in.
            const std::string code =
                fresh.authentication.logins().make_code(principals[i], noon).value();
            CHECK(fresh.authentication.log_in(stranger, "", code, fresh.now, noon).has_value() ==
                  stays);
            ++i;
        }
    }
    CHECK(daemon.tokens().rows().size() == 3);
}

TEST_CASE("a certificate that has expired is told once, and lets nobody stay") {
    GuardedDaemon guarded;
    const auto robot = guarded.come(holder("CN=robot"), "");
    REQUIRE(robot);
    CHECK_FALSE(guarded.authentication.certificates_ended(noon + 23h));
    CHECK(guarded.authentication.still_valid(*robot, noon + 23h));
    CHECK(guarded.authentication.certificates_ended(noon + 24h));
    CHECK_FALSE(guarded.authentication.certificates_ended(noon + 24h));
    CHECK_FALSE(guarded.authentication.still_valid(*robot, noon + 24h));
    PeerIdentity bare = stranger;
    bare.subject = "CN=robot";
    CHECK(guarded.come(bare, "").error().code == Code::not_allowed);
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
    for (int i = 0; i < 4200; ++i) failures.failed(std::to_string(i), now + 1ms);
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
    PeerIdentity peer = holder("CN=robot");
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
    const std::string code = daemon.logins().make_code(caller, noon).value();
    const auto secret = log_in(code, noon + 1min);
    REQUIRE(secret);
    const auto known = daemon.identify_request(browser, "", *secret, guarded.now, noon);
    CHECK(known->id == "uid:0");
    CHECK(known->role == Role::admin);
    CHECK(log_in(code, noon + 1min).error().code == Code::not_allowed);
    CHECK(log_in(daemon.logins().make_code(caller, noon).value(), noon + 3min).error().code ==
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

TEST_CASE("a principal's codes and logins void its own alone") {
    PageLogins logins;
    const Principal viewer{"vera", {}, Role::viewer};
    const Principal admin{"root", {}, Role::admin};
    const std::string others = logins.make_code(admin, noon).value();
    const std::string first = logins.make_code(viewer, noon).value();
    const std::string cookie = logins.begin(admin, noon).value();
    std::string last;
    for (int i = 0; i < 4200; ++i) {
        last = logins.make_code(viewer, noon + 1s).value();
        CHECK(logins.begin(viewer, noon + 1s));
    }
    CHECK_FALSE(logins.take_code(first, noon + 1s));
    CHECK(logins.take_code(last, noon + 1s));
    CHECK(logins.find_code(others, noon + 1s)->id == "root");
    CHECK(logins.find(cookie, noon + 1s)->id == "root");
    // Many principals together are refused: they void nobody's.
    Code code{};
    for (int i = 0; i < 4200; ++i)
        if (const auto made = logins.begin({std::to_string(i), {}, Role::user}, noon); !made)
            code = made.error().code;
    CHECK(code == Code::busy);
    CHECK(logins.find(cookie, noon + 1s) != nullptr);
    CHECK(logins.find_code(others, noon + 2min) == nullptr);
}

TEST_CASE("a login that a login has made ends with it, and when it does") {
    PageLogins logins;
    const auto made_by = [&](const std::string& cookie, WallClock::time_point now) {
        const std::string code = logins.make_code(*logins.find(cookie, now), now).value();
        return logins.begin(logins.take_code(code, now).value(), now).value();
    };
    const std::string first = logins.begin({"alice", {}, Role::user}, noon).value();
    const std::string second = made_by(first, noon + 8h);
    const std::string third = made_by(second, noon + 11h);
    CHECK(logins.find(third, noon + 11h + 59min) != nullptr);
    CHECK(logins.find(third, noon + 12h) == nullptr);
    const std::uint64_t number = logins.find(third, noon)->page_login;
    CHECK(logins.goes_on(number));
    // The one in the middle takes the last one with it, and not the first.
    CHECK(logins.end(second));
    CHECK(logins.find(first, noon) != nullptr);
    CHECK_FALSE(logins.goes_on(number));
    CHECK(logins.expire(noon));
    CHECK_FALSE(logins.expire(noon));
    // A chain of any length keeps those that it goes with.
    std::string cookie = made_by(first, noon);
    for (int i = 0; i < 60; ++i) cookie = made_by(cookie, noon);
    for (int i = 0; i < 60; ++i) (void)made_by(first, noon);
    CHECK(logins.find(first, noon) != nullptr);
    CHECK(logins.expire(noon + 12h));
    CHECK(logins.find(cookie, noon) == nullptr);
}

TEST_CASE("a code asks before it logs in somebody else than is there") {
    GuardedDaemon guarded;
    Authentication& daemon = guarded.authentication;
    const std::string cookie = daemon.log_in(browser, guarded.alice, "", guarded.now, noon).value();
    const auto code_of = [&](const char* name, Admittance admittance = {}) {
        const bool is_daemons_user = admittance.place == Place::own_user;
        const Role role = is_daemons_user ? Role::admin : *guarded.policy.anonymous;
        return daemon.logins()
            .make_code({name, {}, role, "", 0, std::move(admittance)}, noon)
            .value();
    };
    const auto local = [](Place place) { return Admittance{Admittance::By::transport, place}; };
    const std::string other = code_of("uid:1", local(Place::other_user));
    const PeerIdentity page{"192.0.2.9", Place::remote, "https"};
    const PeerIdentity bob = holder("CN=bob");
    CHECK(daemon.question_before(bob, other, "", noon).find("CN=bob") != std::string::npos);
    const std::string question = daemon.question_before(page, other, cookie, noon);
    CHECK(question.find("logged in as alice") != std::string::npos);
    CHECK(question.find("in as uid:1") != std::string::npos);
    CHECK(daemon.question_before(page, code_of("alice"), cookie, noon).empty());
    // Where nobody is logged in, it asks, too: but for the daemon's own user, and who is there.
    for (const PeerIdentity& nobody : {page, PeerIdentity{"127.0.0.1", Place::loopback, "http"}})
        CHECK(daemon.question_before(nobody, other, "", noon) ==
              "this page is not logged in, and the address logs it in as uid:1");
    CHECK(daemon.question_before(page, code_of("uid:0", local(Place::own_user)), "", noon).empty());
    const std::string same = code_of("127.0.0.1", local(Place::loopback));
    CHECK(daemon.question_before({"127.0.0.1", Place::loopback, "http"}, same, "", noon).empty());
    // With its name, but behind a proxy, or with a certificate that lets nobody in: not the same.
    PeerIdentity refused{"127.0.0.1", Place::loopback, "http"};
    refused.subject = "127.0.0.1";
    for (const PeerIdentity& other_peer :
         {PeerIdentity{"127.0.0.1", Place::remote, "http"}, refused})
        CHECK(daemon.question_before(other_peer, same, "", noon) ==
              "this page is not logged in, and the address logs it in as 127.0.0.1");
    // A code that ends in an error asks nothing.
    const std::string revoked = code_of("carl", {Admittance::By::token});
    CHECK(daemon.question_before(page, revoked, "", noon).empty());
    CHECK(daemon.question_before(page, "", cookie, noon).empty());
    CHECK(daemon.question_before(page, other, cookie, noon + 3min).empty());
    guarded.put({});
    CHECK(daemon.question_before(page, other, cookie, noon) ==
          daemon.question_before(page, other, "", noon));
}

TEST_CASE("a changed limit counts for logins that there are") {
    PageLogins logins;
    const std::string cookie = logins.begin({"alice", {}, Role::user}, noon).value();
    const std::string code = logins.make_code({"alice", {}, Role::user}, noon).value();
    protocol::Limits limits;
    limits.page_login_ms_max = limits.page_code_ms_max = 1000;
    logins.set_limits(limits);
    CHECK(logins.find(cookie, noon) != nullptr);
    CHECK(logins.find(cookie, noon + 1s) == nullptr);
    CHECK(logins.find_code(code, noon + 1s) == nullptr);
}

}  // namespace
}  // namespace raynest::server
