// The controls of the load test: servers that send the same bytes without any work. They tell the
// cost of a request from the cost of sockets on this machine at this moment.
#pragma once

#include "tests/bench/load_test/sockets.h"

#include <cstddef>
#include <memory>
#include <vector>

namespace raynest::client {

/// A server that answers on its connections until it is destroyed.
class Echo {
public:
    Echo() = default;
    Echo(const Echo&) = delete;
    Echo& operator=(const Echo&) = delete;
    virtual ~Echo() = default;
};

/// Every `request_bytes` received bytes are answered by `reply`.
struct EchoScript {
    std::size_t request_bytes = 0;
    std::vector<std::byte> reply;
};

/// A thread with Boost.Asio for all connections: the minimum for a server such as the daemon.
std::unique_ptr<Echo> echo_by_asio(std::vector<Descriptor> sockets, EchoScript script);
/// A thread with blocking calls for each connection: the minimum that sockets allow.
std::unique_ptr<Echo> echo_by_threads(std::vector<Descriptor> sockets, EchoScript script);

}  // namespace raynest::client
