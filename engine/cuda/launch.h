// The host side of a GPU call.
#pragma once

#include "engine/packs/abi.h"

#include <cstdint>

namespace raynest::cuda {

/// Number of threads per block, one ray each.
inline constexpr std::uint32_t block_rays = 128;

/// Runs `kernel(TraceCall, CompressedTrees, *values)` over the rays of `call` on the current
/// device.
///
/// A call with a target (cuda/slot.h) is queued there. A call without one copies the scene, the
/// rays and the answers itself, waits, and keeps nothing; it is slow. Returns trace_no_device if no
/// GPU answers. Thread-safe.
TraceStatus launch(const TraceCall& call, Query kind, const void* kernel, void* values) noexcept;

}  // namespace raynest::cuda
