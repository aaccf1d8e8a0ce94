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

/// The place of a file among those that a request sends, for the progress.
struct Among {
    std::uint64_t before = 0;  ///< bytes of the files before it
    std::uint64_t total = 0;   ///< bytes of all files; 0: there is this one alone
};

/// Copies the bytes of a file from `offset` on.
using ReadFile = std::function<Result<void>(std::uint64_t offset, std::span<std::byte> into)>;

/// Sends file number `number` of the running request, which has `bytes`. An empty file needs no
/// frame.
Result<void> send_file(Connection& connection, std::uint32_t number, std::uint64_t bytes,
                       const ReadFile& read, Progress& progress, const FrameConsumer& consume,
                       const Among& among = {});
/// The same for a file in memory.
Result<void> send_file(Connection& connection, std::uint32_t number,
                       std::span<const std::byte> bytes, Progress& progress,
                       const FrameConsumer& consume, const Among& among = {});

}  // namespace raynest::client
