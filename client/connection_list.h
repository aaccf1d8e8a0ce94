// The daemon's connections, page by page; only administrators may ask for them.
#pragma once

#include "client/connection.h"

#include <cstdint>
#include <functional>
#include <string>

namespace raynest::client {

struct ListedConnection {
    std::uint64_t number = 0;
    std::string principal, role, transport, peer;
    double age_seconds = 0;
    std::uint32_t jobs = 0;
};

/// Passes on every connection, by number.
Result<void> each_connection(Connection& connection,
                             const std::function<void(const ListedConnection&)>& consume);

}  // namespace raynest::client
