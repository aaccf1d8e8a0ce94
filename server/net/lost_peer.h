// Whether the peer of a TCP connection has stopped to answer while bytes wait for it.
#pragma once

namespace raynest::server {

/// Keep-alive probes (protocol/keep_alive.h) find a dead peer only while nothing waits to be sent;
/// else TCP itself gives up after a quarter of an hour. A peer whose window is full is no dead one:
/// it answers the probes of its window. Never true of a Unix socket.
[[nodiscard]] bool is_lost(int socket);

}  // namespace raynest::server
