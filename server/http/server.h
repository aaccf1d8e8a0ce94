// HTTP connections: the page, and the WebSocket that is one more transport of sessions.
//
//   Listener ──accept()──► HttpConnection ──HttpRequest──► HttpSite ──HttpReply──► written
//                                └─ status 101 ──► WebSocketTransport ──► Connections
//
// Only the .cpp files of HTTP and WebSocket include Boost.Beast.
#pragma once

#include "server/net/address_set.h"
#include "server/sessions/connections.h"
#include "server/http/site.h"
#include "server/security/tls_context.h"

#include <list>
#include <memory>
#include <string>
#include <utility>

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

    /// Sets whose X-Forwarded-* headers count, for requests that come from now on.
    void set_proxies(AddressSet proxies) { proxies_ = std::move(proxies); }

    /// Serves a connection, with TLS unless `tls` is null. Until its first request has come it
    /// takes one of greeting_connections_max places, afterwards one of http_connections_max. Where
    /// there are too many, one of the address with most of them gives way: one that waits for a
    /// request, else the oldest. At most reserved_places connections have reserved descriptors; a
    /// newcomer takes the place of one of them.
    void accept(Socket socket, Descriptors descriptors, const TlsContext* tls);

private:
    friend class HttpConnection;
    using List = std::list<std::shared_ptr<HttpConnection>>;

    /// Gives a place to a connection whose first request has come.
    void admit(HttpConnection& connection);
    /// Closes the connection of a list that gives way, and counts it.
    static void end_one(const List& list, Metrics::Counter& counter);
    /// Closes a connection with a reserved descriptor if there are reserved_places of them.
    void make_reserved_room();

    asio::io_context& io_;
    const HttpSite& site_;
    Connections& connections_;
    const Services& services_;
    AddressSet proxies_;
    List strangers_;  ///< no request has come yet; by the time of accept()
    List open_;       ///< the others, by the time of their first request
};

}  // namespace raynest::server
