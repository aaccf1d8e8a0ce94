// SHA-256, and the digest of an arena, which names its blob in the state folder.
//
//   digest = SHA-256( SHA-256(piece 0) | SHA-256(piece 1) | ... )    pieces of 64 KiB, the last one
//   shorter
//
// The pieces are hashed in parallel.
// Every tree of digests has two levels, so two arenas with the same digest would be a collision of
// SHA-256 itself. An upload's checksum (protocol/hash.h) is different: it detects damage, not
// forgery.
#pragma once

#include "engine/result.h"

#include <array>
#include <cstddef>
#include <span>
#include <string>
#include <vector>

namespace raynest {

inline constexpr std::size_t digest_piece_bytes = 1 << 16;
using Sha256 = std::array<unsigned char, 32>;

/// Hashes bytes; false where libcrypto is configured to have no SHA-256.
[[nodiscard]] bool hash_bytes(std::span<const std::byte> bytes, Sha256& digest);
/// The error for that, with `internal`.
[[nodiscard]] tl::unexpected<Error> no_sha256();
/// Hashes bytes by their pieces. Uses the threads that a build may use; about 0.6 ns per byte and
/// core where the CPU has SHA instructions, 2.5 ns elsewhere. False as hash_bytes().
[[nodiscard]] bool hash_pieces(std::span<const std::byte> bytes, Sha256& digest);
/// 64 lower-case hex digits.
[[nodiscard]] std::string digest_text(const Sha256& digest);

/// The digest of an arena, as text. Fails with no_sha256().
Result<std::string> arena_digest(std::span<const std::byte> arena);

}  // namespace raynest
