// The identity of a scene: a 256-bit digest of its arena.
//
//   digest = SHA-256( SHA-256(piece 0) | SHA-256(piece 1) | ... )    pieces of 64 KiB, the last one
//   shorter
//
// The pieces are hashed in parallel, and small because an edit hashes those again that it changes.
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

/// Hashes the pieces of an arena of which `stale` is true, each into its place of `pieces`. Both
/// have an entry per piece. Fails as scene_digest() does.
Result<void> hash_pieces(std::span<const std::byte> arena, const std::vector<bool>& stale,
                         std::vector<Sha256>& pieces);
/// Returns the digest of an arena with these pieces.
Result<std::string> scene_digest(std::span<const Sha256> pieces);

/// 64 lower-case hex digits. Uses the threads that a build may use; about 0.6 ns per byte and core
/// where the CPU has SHA instructions, 2.5 ns elsewhere. Fails with `internal` where libcrypto is
/// configured to have no SHA-256.
Result<std::string> scene_digest(std::span<const std::byte> arena);

}  // namespace raynest
