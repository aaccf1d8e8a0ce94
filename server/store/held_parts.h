// Files of an upload that a client need not send, because a scene has what is in them.
#pragma once

#include "protocol/openssl.h"
#include "server/ground/stop.h"
#include "server/store/named_scene.h"

#include <cstddef>
#include <functional>
#include <memory>
#include <span>
#include <vector>

namespace raynest::server {

/// A file that a client would send, and the memory for it.
struct WantedFile {
    const protocol::Sha256Digest* digest = nullptr;
    std::span<std::byte> into;
};

/// Fills in the files that the parts of these scenes were made of (PartFile), which it finds by
/// their length and digest. It hashes at most four times as many bytes as the wanted files have, the first
/// scenes first, and files that look like one that it has hashed not at all. Before it touches the memory of a file it calls `reserve` with
/// its length, and leaves the file out where that returns false. Returns which files it has filled
/// in; none after a stop. For a task.
[[nodiscard]] std::vector<bool> fill_in_held_parts(
    std::span<const std::shared_ptr<const HeldScene>> scenes, std::span<const WantedFile> wanted,
    const std::function<bool(std::uint64_t)>& reserve, const Stop& stop);

}  // namespace raynest::server
