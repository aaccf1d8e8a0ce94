// RAYNEST_FAKE_CUDA=FILE: the line "FUNCTION WHAT [N]" in it makes the next call of that function,
// or the N-th, end in
//   a number   that error; from 700 on it is sticky, as in CUDA: all later calls return it, too
//   kill       the end of the process
//   hang       no answer at all
//   garbage    a copy with wrong data
//   throw      std::bad_alloc, as on a host without memory
// and removes the file. With
//   hold       all such calls wait until somebody else removes the file.
// Copies from the device are called "cudaMemcpyAsync(back)".
// RAYNEST_FAKE_CUDA_ALWAYS="FUNCTION WHAT" does so for every call. RAYNEST_FAKE_CUDA_MEMORY=BYTES
// is the device's memory.
#include "tests/cuda/fake_runtime/cuda_runtime_api.h"

#include <unistd.h>

#include <chrono>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <map>
#include <mutex>
#include <new>
#include <sstream>
#include <string>

namespace {

constexpr int sticky_from = 700;

std::string environment(const char* name, const char* otherwise) {
    const char* value = std::getenv(name);
    return value != nullptr ? value : otherwise;
}

/// A fault to inject: "FUNCTION WHAT [N]".
struct Order {
    std::string function;
    std::string what;
    unsigned number = 1;

    explicit Order(std::istream& from) {
        from >> function >> what;
        if (unsigned n = 0; from >> n) number = n;
    }
};

class Device {
public:
    static Device& get() {
        static Device device;
        return device;
    }

    /// Called when a function starts: returns the fault to inject, or nothing.
    std::string enter(const char* function) {
        std::istringstream always(always_);
        Order order(always);
        if (order.function != function) order.what = next(function);
        while (order.what == "hold") {
            ::usleep(1000);
            order.what = next(function);
        }
        if (order.what == "kill") std::raise(SIGKILL);
        return order.what;
    }
    cudaError_t fail(int error) {
        const std::lock_guard lock(mutex_);
        if (error >= sticky_from) sticky_ = static_cast<cudaError_t>(error);
        return static_cast<cudaError_t>(error);
    }
    cudaError_t sticky() {
        const std::lock_guard lock(mutex_);
        return sticky_;
    }

    cudaError_t allocate(void** block, std::size_t bytes) {
        const std::lock_guard lock(mutex_);
        if (bytes > memory_ - used_) return cudaErrorMemoryAllocation;
        *block = std::malloc(bytes);
        blocks_[static_cast<std::byte*>(*block)] = bytes;
        used_ += bytes;
        return cudaSuccess;
    }
    cudaError_t release(void* block) {
        const std::lock_guard lock(mutex_);
        const auto found = blocks_.find(static_cast<std::byte*>(block));
        if (found == blocks_.end()) return cudaErrorInvalidValue;
        used_ -= found->second;
        blocks_.erase(found);
        std::free(block);
        return cudaSuccess;
    }
    /// True if these bytes lie within one allocation.
    bool owns(const void* at, std::size_t bytes) {
        const std::lock_guard lock(mutex_);
        const auto* first = static_cast<const std::byte*>(at);
        auto found = blocks_.upper_bound(const_cast<std::byte*>(first));
        if (found == blocks_.begin()) return false;
        --found;
        return first + bytes <= found->first + found->second;
    }
    [[nodiscard]] std::size_t memory() const { return memory_; }

private:
    /// Returns the fault that the file requests for this call.
    std::string next(const char* function) {
        const std::lock_guard lock(mutex_);
        std::ifstream file(next_);
        const Order order(file);
        if (order.function != function) return {};
        if (order.what == "hold") return order.what;
        if (++calls_ < order.number) return {};
        calls_ = 0;
        return std::remove(next_.c_str()) == 0 ? order.what : std::string();
    }

    const std::string next_ = environment("RAYNEST_FAKE_CUDA", "");
    const std::string always_ = environment("RAYNEST_FAKE_CUDA_ALWAYS", "");
    std::mutex mutex_;
    unsigned calls_ = 0;  ///< calls that matched the file's fault
    cudaError_t sticky_ = cudaSuccess;
    std::map<std::byte*, std::size_t> blocks_;
    std::size_t used_ = 0;
    const std::size_t memory_ = std::stoull(environment("RAYNEST_FAKE_CUDA_MEMORY", "1000000000"));
};

/// Runs the common start of every function, then `action(true if its result must be wrong)`.
template <class Action>
cudaError_t call(const char* function, Action action) {
    Device& device = Device::get();
    const std::string fault = device.enter(function);
    if (fault == "throw") throw std::bad_alloc();
    if (fault == "hang") {
        for (;;) ::pause();
    }
    if (!fault.empty() && fault != "garbage") return device.fail(std::stoi(fault));
    if (device.sticky() != cudaSuccess) return device.sticky();
    return action(fault == "garbage");
}

cudaError_t copy(void* to, const void* from, std::size_t bytes, cudaMemcpyKind kind, bool wrong) {
    if (kind != cudaMemcpyDeviceToHost && !Device::get().owns(to, bytes))
        return cudaErrorInvalidValue;
    if (kind != cudaMemcpyHostToDevice && !Device::get().owns(from, bytes))
        return cudaErrorInvalidValue;
    std::memcpy(to, from, bytes);
    if (wrong) std::memset(to, 0x5A, bytes);
    return cudaSuccess;
}

}  // namespace

cudaError_t cudaGetDeviceCount(int* count) {
    return call("cudaGetDeviceCount", [&](bool) {
        *count = 1;
        return cudaSuccess;
    });
}
cudaError_t cudaGetDeviceProperties(cudaDeviceProp* properties, int device) {
    return call("cudaGetDeviceProperties", [&](bool) {
        if (device != 0) return cudaErrorInvalidValue;
        *properties = {};
        std::strcpy(properties->name, "a fake of the tests");
        properties->totalGlobalMem = Device::get().memory();
        return cudaSuccess;
    });
}
cudaError_t cudaSetDevice(int device) {
    return call("cudaSetDevice",
                [&](bool) { return device == 0 ? cudaSuccess : cudaErrorInvalidValue; });
}
cudaError_t cudaSetDeviceFlags(unsigned) {
    return call("cudaSetDeviceFlags", [](bool) { return cudaSuccess; });
}
cudaError_t cudaGetLastError() {
    return Device::get().sticky();
}
const char* cudaGetErrorName(cudaError_t error) {
    switch (error) {
        case cudaErrorMemoryAllocation:
            return "cudaErrorMemoryAllocation";
        case cudaErrorInsufficientDriver:
            return "cudaErrorInsufficientDriver";
        case cudaErrorDevicesUnavailable:
            return "cudaErrorDevicesUnavailable";
        case cudaErrorNoDevice:
            return "cudaErrorNoDevice";
        case cudaErrorNoKernelImageForDevice:
            return "cudaErrorNoKernelImageForDevice";
        case cudaErrorIllegalAddress:
            return "cudaErrorIllegalAddress";
        case cudaErrorLaunchFailure:
            return "cudaErrorLaunchFailure";
        default:
            return "cudaErrorUnknown";
    }
}
const char* cudaGetErrorString(cudaError_t) {
    return "said by the fake of the tests";
}

cudaError_t cudaHostRegister(void*, std::size_t, unsigned) {
    return call("cudaHostRegister", [](bool) { return cudaSuccess; });
}
cudaError_t cudaMalloc(void** block, std::size_t bytes) {
    return call("cudaMalloc", [&](bool) { return Device::get().allocate(block, bytes); });
}
cudaError_t cudaFree(void* block) {
    return call("cudaFree", [&](bool) { return Device::get().release(block); });
}
cudaError_t cudaMemcpy(void* to, const void* from, std::size_t bytes, cudaMemcpyKind kind) {
    return call("cudaMemcpy", [&](bool wrong) { return copy(to, from, bytes, kind, wrong); });
}

struct FakeStream {};

cudaError_t cudaStreamCreateWithFlags(cudaStream_t* stream, unsigned) {
    return call("cudaStreamCreateWithFlags", [&](bool) {
        *stream = new FakeStream;
        return cudaSuccess;
    });
}
cudaError_t cudaStreamDestroy(cudaStream_t stream) {
    return call("cudaStreamDestroy", [&](bool) {
        delete stream;
        return cudaSuccess;
    });
}
cudaError_t cudaStreamSynchronize(cudaStream_t) {
    return call("cudaStreamSynchronize", [](bool) { return cudaSuccess; });
}
cudaError_t cudaMemcpyAsync(void* to, const void* from, std::size_t bytes, cudaMemcpyKind kind,
                            cudaStream_t) {
    const bool back = kind == cudaMemcpyDeviceToHost;
    return call(back ? "cudaMemcpyAsync(back)" : "cudaMemcpyAsync",
                [&](bool wrong) { return copy(to, from, bytes, kind, wrong); });
}
cudaError_t cudaMemsetAsync(void* block, int value, std::size_t bytes, cudaStream_t) {
    return call("cudaMemsetAsync", [&](bool) {
        if (!Device::get().owns(block, bytes)) return cudaErrorInvalidValue;
        std::memset(block, value, bytes);
        return cudaSuccess;
    });
}
cudaError_t cudaLaunchKernel(const void* kernel, dim3 blocks, dim3 threads, void** arguments,
                             std::size_t, cudaStream_t) {
    return call("cudaLaunchKernel", [&](bool) {
        reinterpret_cast<FakeKernel>(const_cast<void*>(kernel))(arguments, blocks.x * threads.x);
        return cudaSuccess;
    });
}

cudaError_t cudaFuncGetAttributes(cudaFuncAttributes*, const void*) {
    return call("cudaFuncGetAttributes", [](bool) { return cudaSuccess; });
}

struct FakeEvent {
    std::chrono::steady_clock::time_point at{};
};

cudaError_t cudaEventCreate(cudaEvent_t* event) {
    return call("cudaEventCreate", [&](bool) {
        *event = new FakeEvent;
        return cudaSuccess;
    });
}
cudaError_t cudaEventDestroy(cudaEvent_t event) {
    return call("cudaEventDestroy", [&](bool) {
        delete event;
        return cudaSuccess;
    });
}
cudaError_t cudaEventRecord(cudaEvent_t event, cudaStream_t) {
    return call("cudaEventRecord", [&](bool) {
        event->at = std::chrono::steady_clock::now();
        return cudaSuccess;
    });
}
cudaError_t cudaEventElapsedTime(float* milliseconds, cudaEvent_t begin, cudaEvent_t end) {
    return call("cudaEventElapsedTime", [&](bool) {
        *milliseconds = std::chrono::duration<float, std::milli>(end->at - begin->at).count();
        return cudaSuccess;
    });
}
