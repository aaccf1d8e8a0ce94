// Quotas of the disk (disk_bytes): room for scenes in the state folder.
#pragma once

#include "server/ground/errors.h"

#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <string>

namespace raynest::server {

/// Room of a principal on the disk, for what takes the place of one of its scenes.
struct DiskRoom {
    std::uint64_t bytes = 0;
    std::string owner = {};
    std::string remedy = {};

    /// Fails with QUOTA if so many bytes are too many.
    [[nodiscard]] Reply<void> check(std::uint64_t needed) const;
};

/// Bytes of loads between their check and their entry in the table of scenes. Thread-safe: a load
/// that is stopped ends on any thread.
class DiskClaims {
public:
    [[nodiscard]] std::uint64_t of(const std::string& owner) const;
    /// Counts bytes as the owner's until the result is destroyed.
    [[nodiscard]] std::shared_ptr<void> take(const std::string& owner, std::uint64_t bytes);

private:
    struct Taken {
        std::mutex mutex;
        std::map<std::string, std::uint64_t> bytes;  ///< by owner
    };
    const std::shared_ptr<Taken> taken_ = std::make_shared<Taken>();
};

}  // namespace raynest::server
