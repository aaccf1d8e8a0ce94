// Files of an upload that a client need not send, because a scene has what is in them.
#pragma once

#include "protocol/openssl.h"
#include "server/ground/stop.h"
#include "server/store/named_scene.h"

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <utility>
#include <vector>

namespace raynest::server {

/// The digests of the files of a scene's parts, as far as they are known. Thread-safe.
class PartDigests {
public:
    /// Returns the digest of file `form` of an object; asks `hash` where it is not known, whose answer
    /// may be that it is not to be known now.
    using Digest = std::optional<protocol::Sha256Digest>;
    Digest of(std::uint32_t object, std::size_t form, const std::function<Digest()>& hash);

private:
    std::mutex mutex_;
    std::map<std::pair<std::uint32_t, std::size_t>, protocol::Sha256Digest> digests_;
};

/// A file that a client would send, and the memory for it.
struct WantedFile {
    const protocol::Sha256Digest* digest = nullptr;
    std::span<std::byte> into;
};

/// Fills in the files that the parts of these scenes were made of (PartFile), which it finds by
/// their length and digest. It remembers the digests of a scene's parts; of those that it does not
/// know yet it hashes at most 16 times as many bytes as the wanted files have, the first scenes
/// first. Of wanted files with one digest it fills in one. Before it touches the memory of a file it
/// calls `reserve` with its length, and leaves the file out where that returns false. Returns which
/// files it has filled in. For a task; ends early at a stop.
[[nodiscard]] std::vector<bool> fill_in_held_parts(
    std::span<const std::shared_ptr<const HeldScene>> scenes, std::span<const WantedFile> wanted,
    const std::function<bool(std::uint64_t)>& reserve, const Stop& stop);

}  // namespace raynest::server
