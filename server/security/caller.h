// The connection that asks, and its request.
#pragma once

#include "server/security/principal.h"
#include "server/security/role.h"

#include <cstdint>
#include <string>

namespace raynest::server {

/// An open connection: its principal, its number among all connections, and its role.
struct ConnectionId {
    std::string principal;
    std::uint64_t connection = 0;  ///< from SceneStore::connect(); never reused
    Role role = Role::user;
};

/// A request and its connection.
struct Caller : ConnectionId {
    std::uint64_t request_id = 0;
    std::uint64_t window_bytes = 0;  ///< credit that the client grants to each request at its start
    Principal identity = {};
};

}  // namespace raynest::server
