// Small rules of running a daemon: which users the system names, how often a line is logged, what a
// client is told of files.
#include "server/ground/limited_log.h"
#include "server/ground/own_counts.h"
#include "server/security/authentication.h"
#include "server/security/principal.h"
#include "server/security/user_namespace.h"

#include <doctest/doctest.h>

namespace raynest::server {
namespace {

TEST_CASE("a user namespace tells users apart only if it maps all of them") {
    CHECK(maps_all_users("         0          0 4294967295\n"));
    CHECK_FALSE(maps_all_users(""));
    CHECK_FALSE(maps_all_users("         0          0          1\n"));
    CHECK_FALSE(maps_all_users("0 0 1\n998 998 1\n"));
    CHECK_FALSE(maps_all_users("0 100000 65536\n"));
    CHECK(maps_all_users("0 0 1000\n1000 1000 4294966295\n"));
}

TEST_CASE("a peer whose user is unknown needs a token") {
    using Place = PeerIdentity::Place;
    const PeerIdentity unknown{"uid:65534", Place::unknown_user, "unix"};
    Authentication daemon({Role::user, true, false});
    const std::string token = new_token();
    TokenTable rows;
    rows.put({TokenRow::Kind::token, "bob", Role::user, hash_token(token), {}, {}});
    daemon.set_tokens(std::make_shared<const TokenTable>(std::move(rows)));
    for (const auto& found :
         {daemon.identify(unknown, "", {}, {}), daemon.identify_request(unknown, "", "", {}, {})}) {
        REQUIRE(!found);
        CHECK(found.error().code == Code::not_allowed);
        CHECK(found.error().message.find("stands for several users") != std::string::npos);
    }
    const auto bob = daemon.identify(unknown, token, {}, {});
    REQUIRE(bob);
    CHECK(bob->id == "bob");
    CHECK(daemon.identify({"uid:1", Place::other_user, "unix"}, "", {}, {})->id == "uid:1");
}

TEST_CASE("a few lines per second are written, and the rest is counted") {
    using namespace std::chrono_literals;
    LineLimit limit;
    const LineLimit::Time begin{100s};
    unsigned written = 0;
    for (int i = 0; i < 20; ++i) written += limit.admit("noisy", begin + i * 10ms);
    CHECK(written == LineLimit::lines_max);
    CHECK(limit.admit("another", begin + 400ms));
    CHECK(limit.take_left_out(begin + 500ms).lines == 0);
    for (int i = 0; i < 7; ++i) limit.admit("another", begin + 600ms);
    const LineLimit::LeftOut left_out = limit.take_left_out(begin + 1s);
    CHECK(left_out.lines == 20 - LineLimit::lines_max + 8 - LineLimit::lines_max);
    CHECK(left_out.source == "noisy");
    CHECK(limit.take_left_out(begin + 1s).lines == 0);
    CHECK(limit.admit("noisy", begin + 2s));
    written = 0;
    for (int i = 0; i < 1000; ++i) written += limit.admit(std::to_string(i), begin + 4s);
    CHECK(written == LineLimit::sources_max);
    CHECK(limit.take_left_out(begin + 5s).lines == 1000 - LineLimit::sources_max);
}

TEST_CASE("a machine with many addresses fills no more than their share of the log") {
    using namespace std::chrono_literals;
    LineLimit limit;
    const LineLimit::Time now{100s};
    unsigned written = 0;
    for (int i = 0; i < 200; ++i) {
        const std::string number = std::to_string(i % 100);
        written += limit.admit("2001:db8:0:" + number + "::/64", now);
        written += limit.admit("192.0.2." + number, now);
    }
    CHECK(written == LineLimit::remote_lines_max);
    for (const char* known : {"alice", "CN=robot", "uid:1000", "127.0.0.1", ""})
        CHECK(limit.admit(known, now));
    CHECK(limit.take_left_out(now + 1s).lines == 400 - LineLimit::remote_lines_max);
}

TEST_CASE("each principal has its own counts, and only so many are remembered") {
    OwnCounts counts;
    counts.add("alice", 3, 5);
    counts.add("bob", 3, 1);
    CHECK(counts.of("alice", 3) == 5);
    CHECK(counts.of("alice", 2) == 0);
    CHECK(counts.of("nobody", 3) == 0);
    for (int i = 0; i < 1023; ++i) counts.add(std::string("p").append(std::to_string(i)), 0, 1);
    CHECK(counts.of("alice", 3) == 0);
    CHECK(counts.of("bob", 3) == 1);
    CHECK(counts.of("p1022", 0) == 1);
    counts.add("bob", 3, 1);
    CHECK(counts.latest(2) == std::vector<std::string>{"bob", "p1022"});
}

TEST_CASE("clients are told the names of files, not their folders") {
    CHECK(without_folders("/etc/raynest/raynestd.toml, line 2: no") == "raynestd.toml, line 2: no");
    CHECK(without_folders("listen unix:/run/x/s: the folder /run/x does not") ==
          "listen unix:s: the folder x does not");
    CHECK(without_folders("key '/a/b.pem' of tls://h:1/x and a/b") ==
          "key 'b.pem' of tls://h:1/x and a/b");
    CHECK(without_folders("") == "");
    CHECK(without_folders("/") == "");
}

}  // namespace
}  // namespace raynest::server
