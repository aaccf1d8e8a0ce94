// The transport over a WebSocket, which carries frames as websocket_messages.h says.
#pragma once

#include "protocol/limits.h"
#include "server/http/messages.h"
#include "server/http/stream.h"
#include "server/net/transport.h"

#include <memory>

namespace raynest::server {

/// Makes the transport of a connection that has sent this upgrade; it is answered by open().
[[nodiscard]] std::unique_ptr<Transport> make_websocket(HttpStream stream, PeerIdentity peer,
                                                        PageRequest request,
                                                        const protocol::Limits& limits);

}  // namespace raynest::server
