// Includes Boost.Beast, for the files that speak HTTP or WebSocket.
#pragma once

#include "server/net/asio.h"

#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/core/role.hpp>
#include <boost/beast/http.hpp>
#include <boost/beast/version.hpp>
#include <boost/beast/websocket.hpp>

namespace raynest::server {
namespace beast = boost::beast;
namespace http = beast::http;
}  // namespace raynest::server
