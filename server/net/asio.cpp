// The non-template part of Asio, compiled once: every other file that includes asio.h gets cheaper.
#include "server/net/asio.h"

#include <boost/asio/impl/src.hpp>
