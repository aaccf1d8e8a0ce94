// Connected pairs of sockets for the load test, of the same kind as the daemon's connection.
#pragma once

#include "client/ground/descriptor.h"
#include "client/ground/failure.h"

#include <vector>

namespace raynest::client {

/// Both ends of connections within this process.
struct SocketPairs {
    std::vector<Descriptor> near;
    std::vector<Descriptor> far;
};
/// Makes `count` pairs: Unix sockets if `like` is one, else loopback TCP.
Result<SocketPairs> connect_pairs(int like, std::size_t count);

}  // namespace raynest::client
