// The doors of the cuda pack that are not its table of variants.
#include "engine/packs/device.h"

#include "engine/cuda/device_scene.h"
#include "engine/cuda/slot.h"
#include "engine/cuda/status.h"

#include <algorithm>
#include <cstring>
#include <new>

namespace raynest {
namespace cuda {
namespace {

TraceStatus open(DeviceInfo* info) noexcept {
    // Threads that wait for the device sleep: the cores are for tracing.
    if (const TraceStatus status = status_of(cudaSetDeviceFlags(cudaDeviceScheduleBlockingSync));
        status != trace_ok)
        return status;
    cudaDeviceProp properties{};
    if (const TraceStatus status = status_of(cudaGetDeviceProperties(&properties, 0));
        status != trace_ok)
        return status;
    *info = {};
    std::strncpy(info->name, properties.name, sizeof info->name - 1);
    info->memory_bytes = properties.totalGlobalMem;
    return status_of(cudaSetDevice(0));
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
        return out_of_host_memory();
    }
}

TraceStatus load_scene(const SceneView* scene, DeviceScene** loaded) noexcept {
    return give(loaded, [&](auto& made) { return copy_to_device(*scene, made); });
}

void unload(DeviceScene* scene) noexcept {
    delete scene;
}

std::uint64_t bytes_of(const DeviceScene* scene) noexcept {
    return scene->memory.bytes();
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
        raynest::device_abi, cuda::open,   cuda::last_error, cuda::pin,
        cuda::load_scene,    cuda::unload, cuda::bytes_of,   cuda::new_slot,
        cuda::free_slot,     cuda::start,  cuda::finish,     cuda::kernel_seconds};
    return &device;
}
