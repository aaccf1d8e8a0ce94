// Checks what a kernel pack declares: names that a request could not use, or not tell apart.
#pragma once

#include "engine/packs/abi.h"
#include "engine/result.h"

#include <filesystem>

namespace raynest {

/// Fails with pack_invalid, naming the file, the intersector and what to rename or to turn round: a
/// name that is no word, comes twice, or means something else already; a range or choice without
/// values.
Result<void> check_declarations(const Pack& pack, const std::filesystem::path& file);

}  // namespace raynest
