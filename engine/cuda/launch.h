// The host's side of a GPU call.
#pragma once

#include "engine/packs/abi.h"

#include <cstdint>

namespace raynest::cuda {

/// Threads of a block, one ray each.
inline constexpr std::uint32_t block_rays = 128;

/// Runs `kernel(TraceCall, CompressedTrees, *values)` over the rays of `call` on the current
/// device.
///
/// Where the call names a target (cuda/slot.h) it is queued there. Else it stands alone: it carries
/// the scene, the rays and the answers over, waits, keeps nothing, and is as slow as that.
/// trace_no_device where no GPU answers; thread-safe.
TraceStatus launch(const TraceCall& call, Query kind, const void* kernel, void* values) noexcept;

}  // namespace raynest::cuda
