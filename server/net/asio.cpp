// The non-template part of Asio, compiled once, so that files which include asio.h compile faster.
#include "server/net/asio.h"

#include <boost/asio/impl/src.hpp>
