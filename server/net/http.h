// HTTP connections: the page, and the WebSocket that is one more transport of sessions.
//
//   Listener ──accept()──► HttpConnection ──HttpRequest──► HttpSite ──HttpReply──► written
//                                └─ status 101 ──► WebSocketTransport ──► Connections
//
// Only http.cpp includes Boost.Beast.
#pragma once

#include "server/net/connections.h"
#include "server/net/http_site.h"

#include <list>
#include <memory>

namespace raynest::server {

class HttpConnection;

/// All HTTP connections of the daemon. Io thread only.
class HttpServer {
public:
    HttpServer(asio::io_context& io, const HttpSite& site, Connections& connections,
               const Services& services)
        : io_(io),
          site_(site),
          connections_(connections),
          services_(services) {}
    HttpServer(const HttpServer&) = delete;

    /// Serves a connection. If there are too many, the one that has waited longest for a request is
    /// closed; if none waits, the new one is refused.
    void accept(Socket socket, Connections::Descriptors descriptors);

private:
    friend class HttpConnection;
    using List = std::list<std::shared_ptr<HttpConnection>>;

    /// True once there is room for one more connection.
    bool make_room();

    asio::io_context& io_;
    const HttpSite& site_;
    Connections& connections_;
    const Services& services_;
    List open_;  ///< by the time of accept()
};

}  // namespace raynest::server
