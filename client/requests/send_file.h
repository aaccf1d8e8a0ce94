// Sends a file with the running request, as credit allows.
#pragma once

#include "client/ground/progress.h"
#include "client/net/connection.h"

#include <cstddef>
#include <cstdint>
#include <functional>
#include <span>

namespace raynest::client {

/// Takes the frames that come while the client waits for credit.
using FrameConsumer = std::function<Result<void>(const protocol::Frame&)>;

/// Sends file number `number` of the running request.
Result<void> send_file(Connection& connection, std::uint32_t number,
                       std::span<const std::byte> bytes, Progress& progress,
                       const FrameConsumer& consume);

}  // namespace raynest::client
