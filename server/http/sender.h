// Finds out who sent a request of HTTP, and to which host, where a proxy may stand between.
//
//   the connection ──────────┐
//   request line, Host ──────┼─► find_sender() ─► HttpRequest: sender, host, path, is_encrypted
//   Forwarded, X-Forwarded-* ┘
//
// A request is local only if it comes from loopback, for a loopback host, and bears no trace of a
// proxy. All others need a token, a certificate or a login, whatever --anonymous says. What a proxy
// tells counts only if its address is in --trusted-proxy; everybody else can write such headers,
// too.
#pragma once

#include "server/http/site.h"
#include "server/net/address_set.h"

#include <string_view>

namespace raynest::server {

/// True for a header that proxies add to a request, and browsers and programs do not.
[[nodiscard]] bool is_from_proxies(std::string_view header);

/// Judges a request that came from `peer`, whose identity is in request.sender: takes the host of
/// an absolute target, and what a trusted proxy tells of the sender, host and scheme; makes senders
/// that are not local remote.
void find_sender(HttpRequest& request, const asio::ip::address& peer, const AddressSet& proxies);

}  // namespace raynest::server
