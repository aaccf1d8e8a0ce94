// Who asks: what quotas and fair shares are counted by.
#pragma once

#include "server/net/asio.h"

#include <string>

namespace raynest::server {

/// "uid:1000" of a Unix socket, else the peer's address. All of loopback is one, "127.0.0.1": any
/// program may use any of its addresses, so they tell nobody apart.
[[nodiscard]] std::string principal_of(Socket& socket);

}  // namespace raynest::server
