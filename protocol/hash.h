// The checksum of uploaded files: FNV-1a, 64 bit.
//
// It detects damage and changes of files. It does not protect against someone who makes two files
// with one checksum, so a daemon never uses it to serve one principal's bytes to
// another.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

namespace raynest::protocol {

/// Returns the checksum; `hash` is that of preceding bytes, if the input comes in parts.
[[nodiscard]] constexpr std::uint64_t upload_checksum(std::span<const std::byte> bytes,
                                                      std::uint64_t hash = 0xCBF29CE484222325ULL) {
    for (const std::byte byte : bytes) {
        hash ^= static_cast<std::uint64_t>(byte);
        hash *= 0x100000001B3ULL;
    }
    return hash;
}

}  // namespace raynest::protocol
