// A message of a peer that no frame could be made of.
#pragma once

#include "protocol/errors.h"

#include <cstdint>

namespace raynest::server {

/// Only transports that translate messages have any.
struct Unreadable {
    std::uint16_t type = 0;  ///< 0: not known
    std::uint64_t request_id = 0;
    protocol::Error error;
    bool closes = false;  ///< the connection ends
};

}  // namespace raynest::server
