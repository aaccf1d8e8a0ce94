// The content hash of uploaded files: FNV-1a, 64 bit.
//
// It finds damage and tells unchanged files apart from changed ones; it is no defence against
// somebody who wants two files to look alike, so a daemon never serves one principal's bytes to
// another by it.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

namespace raynest::protocol {

/// Of bytes that come in pieces, `hash` is that of those before.
[[nodiscard]] constexpr std::uint64_t upload_checksum(std::span<const std::byte> bytes,
                                                   std::uint64_t hash = 0xCBF29CE484222325ULL) {
    for (const std::byte byte : bytes) {
        hash ^= static_cast<std::uint64_t>(byte);
        hash *= 0x100000001B3ULL;
    }
    return hash;
}

}  // namespace raynest::protocol
