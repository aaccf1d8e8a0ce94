// Includes Boost.Asio with two workarounds. Other files include this header, never Asio's own.
//
// Boost 1.74 uses std::exchange without including <utility>. It does not recognise the coroutines
// of clang 14 and 16 without two macros. Two rules for code that includes this header: do not write
// a lambda with captures as a temporary inside a co_await expression, because g++ 12 destroys it
// twice (name it and std::move it); do not cancel a coroutine of another executor.
#pragma once

#if defined(__clang__)
#define BOOST_ASIO_HAS_CO_AWAIT
#define BOOST_ASIO_HAS_STD_COROUTINE
#endif

/// Compiles the non-template part of Asio once, in asio.cpp.
#define BOOST_ASIO_SEPARATE_COMPILATION

// clang-format off
#include <utility>
#include <boost/asio/awaitable.hpp>
// clang-format on
#include <boost/asio/buffer.hpp>
#include <boost/asio/co_spawn.hpp>
#include <boost/asio/compose.hpp>
#include <boost/asio/generic/stream_protocol.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/local/stream_protocol.hpp>
#include <boost/asio/posix/stream_descriptor.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/redirect_error.hpp>
#include <boost/asio/signal_set.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/asio/use_awaitable.hpp>

namespace raynest::server {
namespace asio = boost::asio;
using SystemError = boost::system::error_code;
/// A connected stream, TCP or Unix.
using Socket = asio::generic::stream_protocol::socket;
}  // namespace raynest::server
