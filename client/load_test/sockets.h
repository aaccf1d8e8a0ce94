// Plain sockets for the load test: connected pairs of the kind that the daemon is reached by.
#pragma once

#include "client/descriptor.h"
#include "client/failure.h"

#include <vector>

namespace raynest::client {

/// The two ends of connections within this process.
struct SocketPairs {
    std::vector<Descriptor> near;
    std::vector<Descriptor> far;
};
/// `count` of them, over a Unix socket where `like` is one, else over loopback TCP.
Result<SocketPairs> connect_pairs(int like, std::size_t count);

}  // namespace raynest::client
