// The content hash of an arena: the same scene has the same name on every machine.
//
// Not cryptographic. It tells contents apart; it does not stop someone who wants two scenes to
// collide, so nothing may grant access by it.
#pragma once

#include <cstddef>
#include <span>
#include <string>

namespace raynest {

/// 128 bits as 32 lower-case hex digits. About 2 bytes per clock cycle.
std::string content_hash(std::span<const std::byte> bytes);

}  // namespace raynest
