// Tests the matrix of roles: every request of requests.def, sent in every role.
#include "protocol/text.h"
#include "tests/golden/examples.h"
#include "tests/unit/server/small_daemon.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <map>
#include <string>

namespace raynest::server {
namespace {

/// The least role of each request, by message type.
std::map<std::uint16_t, Role> needed_roles() {
    return {
#define RAYNEST_REQUEST(number, Name, handler, needs, role, ...) {number, Role::role},
#include "protocol/lists/requests.def"
    };
}

/// True if the daemon has refused the request because of its sender's role.
bool refused_by_role(test::SmallDaemon& daemon) {
    return std::ranges::any_of(daemon.sent, [&](const protocol::Frame& frame) {
        if (frame.header.type != static_cast<std::uint16_t>(wire::Message::Error)) return false;
        const auto error = protocol::open<wire::Error>(frame, daemon.limits);
        return error && (*error)->code() == static_cast<std::uint32_t>(Code::not_allowed) &&
               protocol::text((*error)->message()).find("needs the role") != std::string::npos;
    });
}

TEST_CASE("each request is allowed from its least role on, and in no lesser one") {
    test::SmallDaemon daemon;
    const std::map<std::uint16_t, Role> roles = needed_roles();
    std::map<std::uint16_t, Role> untested = roles;
    for (const golden::Example& example : golden::examples()) {
        const auto needed = roles.find(example.frame.header.type);
        if (needed == roles.end()) continue;
        untested.erase(needed->first);
        for (const Role role : {Role::viewer, Role::user, Role::admin}) {
            CAPTURE(example.name);
            CAPTURE(role_name(role));
            test::Client client(daemon, "me", role);
            client.receive(*protocol::encode(0, wire::HelloT{}));
            daemon.sent.clear();
            client.receive(golden::copy(example.frame));
            CHECK(refused_by_role(daemon) == (role < needed->second));
            client.abandon();
            daemon.settle();
        }
    }
    CHECK(untested.empty());
}

TEST_CASE("a welcome says who the client is, and in which role") {
    test::SmallDaemon daemon;
    test::Client client(daemon, "alice", Role::viewer);
    client.receive(*protocol::encode(0, wire::HelloT{}));
    const auto welcome = protocol::open<wire::Welcome>(daemon.sent.at(0), daemon.limits);
    REQUIRE(welcome);
    CHECK(protocol::text((*welcome)->principal()) == "alice");
    CHECK(protocol::text((*welcome)->role()) == "viewer");
}

}  // namespace
}  // namespace raynest::server
