// The controls of the load test: servers that answer the same bytes without doing anything, so that
// what a request costs can be told from what a socket costs on this machine at this moment.
#pragma once

#include "client/load_test/sockets.h"

#include <cstddef>
#include <memory>
#include <vector>

namespace raynest::client {

/// Answers on its connections until it is destroyed.
class Echo {
public:
    Echo() = default;
    Echo(const Echo&) = delete;
    Echo& operator=(const Echo&) = delete;
    virtual ~Echo() = default;
};

/// To every `request_bytes` the answer is `reply`.
struct EchoScript {
    std::size_t request_bytes = 0;
    std::vector<std::byte> reply;
};

/// One thread with Boost.Asio for all connections: the least that a server of its kind can do.
std::unique_ptr<Echo> echo_by_asio(std::vector<Descriptor> sockets, EchoScript script);
/// A thread with blocking calls for each connection: the least that sockets can do.
std::unique_ptr<Echo> echo_by_threads(std::vector<Descriptor> sockets, EchoScript script);

}  // namespace raynest::client
