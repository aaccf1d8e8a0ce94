// HTTP connections: the page, and the WebSocket that is one more transport of sessions.
//
//   Listener ──accept()──► HttpConnection ──HttpRequest──► HttpSite ──HttpReply──► written
//                                └─ status 101 ──► WebSocketTransport ──► Connections
//
// Only the .cpp files of HTTP and WebSocket include Boost.Beast.
#pragma once

#include "server/net/connections.h"
#include "server/net/http_site.h"
#include "server/security/tls_context.h"

#include <list>
#include <memory>
#include <string>

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

    /// Serves a connection, with TLS unless `tls` is null. If there are too many, the one that has
    /// waited longest for a request is closed. If none waits, the oldest of the address with most of
    /// them makes room for another address; else the new one is refused.
    void accept(Socket socket, Connections::Descriptors descriptors, const TlsContext* tls);

private:
    friend class HttpConnection;
    using List = std::list<std::shared_ptr<HttpConnection>>;

    /// True once there is room for one more connection of this address.
    bool make_room(const std::string& address);

    asio::io_context& io_;
    const HttpSite& site_;
    Connections& connections_;
    const Services& services_;
    List open_;  ///< by the time of accept()
};

}  // namespace raynest::server
