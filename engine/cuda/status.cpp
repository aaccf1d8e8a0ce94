#include "engine/cuda/status.h"

#include <cstdio>

namespace raynest::cuda {
namespace {

thread_local char error_text[256] = "";

}  // namespace

TraceStatus status_of(cudaError_t error) noexcept {
    if (error == cudaSuccess) return trace_ok;
    std::snprintf(error_text, sizeof error_text, "%s: %s", cudaGetErrorName(error),
                  cudaGetErrorString(error));
    // Clear the error; otherwise the next call would report it.
    (void)cudaGetLastError();
    return error == cudaErrorMemoryAllocation ? trace_out_of_memory : trace_no_device;
}

TraceStatus out_of_host_memory() noexcept {
    std::snprintf(error_text, sizeof error_text, "the host has no memory left");
    return trace_out_of_memory;
}

const char* last_error() noexcept {
    return error_text;
}

}  // namespace raynest::cuda
