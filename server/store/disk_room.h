// Quotas of the disk (disk_bytes): room for scenes in the state folder; and what loads under way take
// of all quotas.
#pragma once

#include "server/ground/errors.h"

#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <set>
#include <string>

namespace raynest::server {

/// Room of a principal on the disk, for what takes the place of one of its scenes.
struct DiskRoom {
    std::uint64_t bytes = 0;
    std::string owner = {};
    std::string remedy = {};
    std::set<std::string> blobs = {};  ///< digests of its other scenes there: each counts once

    /// Fails with QUOTA if so many bytes are too many.
    [[nodiscard]] Reply<void> check(std::uint64_t needed) const;
    /// The same for a scene of this digest and size.
    [[nodiscard]] Reply<void> check(const std::string& digest, std::uint64_t size) const {
        return check(needed_for(digest, size));
    }
    [[nodiscard]] std::uint64_t needed_for(const std::string& digest, std::uint64_t size) const {
        return blobs.contains(digest) ? 0 : size;
    }
};

/// Parts of an owner's quotas.
struct Claim {
    std::uint64_t disk_bytes = 0;
    std::uint64_t scenes = 0;
    std::uint64_t scene_bytes = 0;
    bool operator==(const Claim&) const = default;
};

/// The parts that loads take between their check and their entry in the table of scenes.
/// Thread-safe: a load that is stopped ends on any thread.
class Claims {
public:
    [[nodiscard]] Claim of(const std::string& owner) const;
    /// Counts the claim as the owner's until the result is destroyed.
    [[nodiscard]] std::shared_ptr<void> take(const std::string& owner, const Claim& claim);

private:
    struct Taken {
        std::mutex mutex;
        std::map<std::string, Claim> sums;  ///< by owner
    };
    const std::shared_ptr<Taken> taken_ = std::make_shared<Taken>();
};

}  // namespace raynest::server
