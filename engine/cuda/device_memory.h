// Arrays in a GPU's memory, freed with their owner.
#pragma once

#include <cuda_runtime_api.h>

#include <cstdint>
#include <vector>

namespace raynest::cuda {

/// Arrays on the device. Keeps the first error and does nothing after it, so that the caller can
/// check once, at the end.
class DeviceMemory {
public:
    DeviceMemory() = default;
    DeviceMemory(const DeviceMemory&) = delete;
    DeviceMemory& operator=(const DeviceMemory&) = delete;
    ~DeviceMemory() {
        for (void* block : blocks_) cudaFree(block);
    }

    /// Allocates an array; null after an error, and for a count of 0.
    template <class T>
    [[nodiscard]] T* room(std::uint64_t count) {
        if (count == 0 || error_ != cudaSuccess) return nullptr;
        void* block = nullptr;
        blocks_.reserve(blocks_.size() + 1);
        error_ = cudaMalloc(&block, count * sizeof(T));
        if (error_ != cudaSuccess) return nullptr;
        blocks_.push_back(block);
        return static_cast<T*>(block);
    }

    [[nodiscard]] cudaError_t error() const { return error_; }

private:
    std::vector<void*> blocks_;
    cudaError_t error_ = cudaSuccess;
};

}  // namespace raynest::cuda
