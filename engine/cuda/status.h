// Translates errors of the CUDA runtime into a pack's status.
#pragma once

#include "engine/packs/abi.h"

#include <cuda_runtime_api.h>

namespace raynest::cuda {

/// Converts an error and stores it for last_error(). Only lack of memory is certain to leave the
/// device usable, so every other error is trace_no_device.
TraceStatus status_of(cudaError_t error) noexcept;

/// Returns trace_out_of_memory, for the host's memory.
TraceStatus out_of_host_memory() noexcept;

/// Returns name and text of the last error that status_of() received on this thread.
[[nodiscard]] const char* last_error() noexcept;

}  // namespace raynest::cuda
