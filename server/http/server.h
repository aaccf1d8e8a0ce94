// HTTP connections: the page, and the WebSocket that is one more transport of sessions.
//
//   Listener ──accept()──► HttpConnection ──HttpRequest──► HttpSite ──HttpReply──► written
//                                └─ status 101 ──► WebSocketTransport ──► Accept
//
// Only the .cpp files of HTTP and WebSocket include Boost.Beast.
#pragma once

#include "protocol/limits.h"
#include "server/ground/metrics.h"
#include "server/http/site.h"
#include "server/net/address_set.h"
#include "server/net/descriptors.h"
#include "server/net/transport.h"
#include "server/security/tls_context.h"

#include <functional>
#include <list>
#include <memory>
#include <utility>

namespace raynest::server {

class HttpConnection;

/// All HTTP connections of the daemon. Io thread only.
class HttpServer {
public:
    /// Takes a connection that has become a WebSocket.
    using Accept = std::function<void(std::unique_ptr<Transport>, Descriptors)>;

    HttpServer(asio::io_context& io, const HttpSite& site, const protocol::Limits& limits,
               Metrics& metrics, Accept accept)
        : io_(io),
          site_(site),
          limits_(limits),
          metrics_(metrics),
          accept_(std::move(accept)) {}
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
    const protocol::Limits& limits_;
    Metrics& metrics_;
    const Accept accept_;
    AddressSet proxies_;
    List strangers_;  ///< no request has come yet; by the time of accept()
    List open_;       ///< the others, by the time of their first request
};

}  // namespace raynest::server
