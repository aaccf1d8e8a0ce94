// Why the device takes no call at this moment.
#pragma once

#include "server/execution/backend.h"

#include <string>
#include <utility>

namespace raynest::server::device {

inline Unavailable later(std::string reason, std::uint32_t retry_after_ms) {
    return {std::move(reason), protocol::Code::busy, retry_after_ms};
}

inline Unavailable no_room(std::string reason) {
    return {std::move(reason), protocol::Code::resource_exhausted, 1000};
}

inline Unavailable lost(std::string reason) {
    return {std::move(reason), protocol::Code::busy, 1000, true};
}

}  // namespace raynest::server::device
