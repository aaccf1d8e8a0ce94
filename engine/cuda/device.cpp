// Entry points of the cuda pack other than its table of variants.
#include "engine/packs/device.h"

#include "engine/cuda/device_scene.h"
#include "engine/cuda/make_rays.h"
#include "engine/cuda/slot.h"
#include "engine/cuda/status.h"

#include <algorithm>
#include <cstring>
#include <new>
#include <span>

namespace raynest {
namespace cuda {
namespace {

/// True if the error lasts until the machine or its driver changes. Other errors may pass, such as
/// those of a device that is starting or in another process's exclusive use.
bool is_absence(cudaError_t error) {
    switch (error) {
        case cudaErrorStubLibrary:
        case cudaErrorInsufficientDriver:
        case cudaErrorNoDevice:
        case cudaErrorNoKernelImageForDevice:
        case cudaErrorUnsupportedPtxVersion:
        case cudaErrorSystemDriverMismatch:
        case cudaErrorCompatNotSupportedOnDevice:
            return true;
        default:
            return false;
    }
}

TraceStatus open(DeviceInfo* info) noexcept {
    cudaDeviceProp properties{};
    const auto take = [&]() -> cudaError_t {
        // Threads that wait for the device sleep, so that the cores are free for tracing.
        if (const auto error = cudaSetDeviceFlags(cudaDeviceScheduleBlockingSync)) return error;
        if (const auto error = cudaGetDeviceProperties(&properties, 0)) return error;
        if (const auto error = cudaSetDevice(0)) return error;
        // Test that the pack has code for this device.
        cudaFuncAttributes kernel{};
        return cudaFuncGetAttributes(&kernel, make_rays_kernel());
    };
    const cudaError_t error = take();
    *info = {};
    std::strncpy(info->name, properties.name, sizeof info->name - 1);
    info->memory_bytes = properties.totalGlobalMem;
    info->absent = is_absence(error);
    return status_of(error);
}

TraceStatus pin(void* memory, std::uint64_t bytes) noexcept {
    return status_of(cudaHostRegister(memory, bytes, cudaHostRegisterDefault));
}

template <class T, class Make>
TraceStatus give(T** to, Make make) noexcept {
    try {
        std::unique_ptr<T> made;
        const TraceStatus status = make(made);
        *to = made.release();
        return status;
    } catch (const std::bad_alloc&) {
        *to = nullptr;
        (void)out_of_host_memory();
        return trace_cancelled;  // a host error: device memory would not help
    }
}

TraceStatus load_scene(const SceneView* scene, DeviceScene** loaded) noexcept {
    return give(loaded, [&](auto& made) { return copy_to_device(*scene, made); });
}

TraceStatus load_changed(const DeviceScene* base, const ChangedRange* ranges, std::uint32_t count,
                         DeviceScene** loaded) noexcept {
    return give(loaded,
                [&](auto& made) { return copy_changed(*base, std::span(ranges, count), made); });
}

void unload(DeviceScene* scene) noexcept {
    delete scene;
}

std::uint64_t copied_bytes(const DeviceScene* scene) noexcept {
    return scene->copied_bytes;
}

TraceStatus new_slot(std::uint64_t rays_max, std::uint64_t hits_max, DeviceSlot** slot) noexcept {
    return give(slot, [&](auto& made) { return make_slot(rays_max, hits_max, made); });
}

void free_slot(DeviceSlot* slot) noexcept {
    delete slot;
}

TraceStatus start(DeviceSlot* slot, const DeviceScene* scene, TraceFunction kernel,
                  const TraceCall* call, const PinholeRays* made) noexcept {
    const Target target{*slot, *scene, made};
    TraceCall aimed = *call;
    aimed.device = &target;
    return kernel(&aimed);
}

TraceStatus finish(DeviceSlot* slot) noexcept {
    return status_of(cudaStreamSynchronize(slot->stream));
}

TraceStatus kernel_seconds(const DeviceSlot* slot, double* seconds) noexcept {
    float milliseconds = 0;
    const cudaError_t error =
        cudaEventElapsedTime(&milliseconds, slot->kernel_begin, slot->kernel_end);
    *seconds = 1e-3 * static_cast<double>(milliseconds);
    return status_of(error);
}

}  // namespace
}  // namespace cuda

bool is_supported() noexcept {
    int count = 0;
    return cudaGetDeviceCount(&count) == cudaSuccess && count > 0;
}

}  // namespace raynest

extern "C" [[gnu::visibility("default")]] const raynest::Device* raynest_device() noexcept {
    namespace cuda = raynest::cuda;
    static constexpr raynest::Device device{
        raynest::device_abi, cuda::open,          cuda::last_error, cuda::pin,
        cuda::load_scene,    cuda::load_changed,  cuda::unload,     cuda::copied_bytes,
        cuda::scene_bytes,   cuda::new_slot,      cuda::free_slot,  cuda::start,
        cuda::finish,        cuda::kernel_seconds};
    return &device;
}
