// What the CUDA runtime says, as a pack says it.
#pragma once

#include "engine/packs/abi.h"

#include <cuda_runtime_api.h>

namespace raynest::cuda {

/// Remembers an error for last_error(). Of the rest no other than lack of memory leaves the device
/// as it was for certain, so all are trace_no_device.
TraceStatus status_of(cudaError_t error) noexcept;

/// trace_out_of_memory, of the host.
TraceStatus out_of_host_memory() noexcept;

/// Name and text of what status_of() last saw fail on this thread.
[[nodiscard]] const char* last_error() noexcept;

}  // namespace raynest::cuda
