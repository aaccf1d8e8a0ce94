#include "engine/cuda/launch.h"

#include "engine/cuda/device_scene.h"
#include "engine/cuda/make_rays.h"
#include "engine/cuda/slot.h"
#include "engine/cuda/status.h"

#include <new>

namespace raynest::cuda {
namespace {

/// Runs a series of runtime calls and keeps the first error; makes no call after it.
class Steps {
public:
    template <class Step>
    Steps& then(Step step) {
        if (error_ == cudaSuccess) error_ = step();
        return *this;
    }
    [[nodiscard]] cudaError_t error() const { return error_; }

private:
    cudaError_t error_ = cudaSuccess;
};

cudaError_t run(const void* kernel, std::uint32_t threads, void** arguments, cudaStream_t stream) {
    const std::uint32_t blocks = (threads + block_rays - 1) / block_rays;
    return cudaLaunchKernel(kernel, dim3(blocks), dim3(block_rays), arguments, 0, stream);
}

TraceStatus queue(const Target& target, const TraceCall& call, Query kind, const void* kernel,
                  void* values) {
    DeviceSlot& slot = target.slot;
    const bool multi = kind == query_multi;
    const std::uint64_t hit_count = std::uint64_t{call.ray_count} * call.hits_max;
    if (call.ray_count > slot.rays_max || hit_count > slot.hits_max) return trace_bad_call;

    TraceCall device = call;
    device.scene = target.scene.view;
    device.params = nullptr;
    device.rays = slot.rays;
    device.hits = slot.hits;
    device.hit_counts = multi ? slot.hit_counts : nullptr;
    device.device = nullptr;
    CompressedTrees trees = target.scene.trees;
    void* arguments[] = {&device, &trees, values};

    Steps steps;
    if (target.made != nullptr) {
        PinholeRays made = *target.made;
        void* made_arguments[] = {&made, &slot.rays, &device.ray_count};
        steps.then(
            [&] { return run(make_rays_kernel(), call.ray_count, made_arguments, slot.stream); });
    } else {
        steps.then([&] {
            return cudaMemcpyAsync(slot.rays, call.rays, call.ray_count * sizeof(Ray),
                                   cudaMemcpyHostToDevice, slot.stream);
        });
    }
    // Clear the hits: nothing is written after a ray's last hit, and old data must not leak.
    if (multi) {
        steps.then([&] {
            return cudaMemsetAsync(slot.hits, 0, hit_count * sizeof(HitRecord), slot.stream);
        });
    }
    steps.then([&] { return cudaEventRecord(slot.kernel_begin, slot.stream); })
        .then([&] { return run(kernel, call.ray_count, arguments, slot.stream); })
        .then([&] { return cudaEventRecord(slot.kernel_end, slot.stream); });
    steps.then([&] {
        return cudaMemcpyAsync(call.hits, slot.hits, hit_count * sizeof(HitRecord),
                               cudaMemcpyDeviceToHost, slot.stream);
    });
    if (multi) {
        steps.then([&] {
            return cudaMemcpyAsync(call.hit_counts, slot.hit_counts,
                                   call.ray_count * sizeof(std::uint32_t), cudaMemcpyDeviceToHost,
                                   slot.stream);
        });
    }
    return status_of(steps.error());
}

TraceStatus run_alone(const TraceCall& call, Query kind, const void* kernel, void* values) {
    std::unique_ptr<DeviceScene> scene;
    std::unique_ptr<DeviceSlot> slot;
    TraceStatus status = copy_to_device(*call.scene, scene);
    if (status == trace_ok) {
        const std::uint64_t hit_count = std::uint64_t{call.ray_count} * call.hits_max;
        status = make_slot(call.ray_count, hit_count, slot);
    }
    if (status == trace_ok) status = queue({*slot, *scene, nullptr}, call, kind, kernel, values);
    if (status == trace_ok) status = status_of(cudaStreamSynchronize(slot->stream));
    return status;
}

}  // namespace

TraceStatus make_slot(std::uint64_t rays_max, std::uint64_t hits_max,
                      std::unique_ptr<DeviceSlot>& made) {
    auto slot = std::make_unique<DeviceSlot>();
    slot->rays_max = rays_max;
    slot->hits_max = hits_max;
    Steps steps;
    steps.then([&] { return cudaStreamCreateWithFlags(&slot->stream, cudaStreamNonBlocking); })
        .then([&] { return cudaEventCreate(&slot->kernel_begin); })
        .then([&] { return cudaEventCreate(&slot->kernel_end); });
    if (steps.error() != cudaSuccess) return status_of(steps.error());
    slot->rays = slot->memory.room<Ray>(rays_max);
    slot->hits = slot->memory.room<HitRecord>(hits_max);
    slot->hit_counts = slot->memory.room<std::uint32_t>(rays_max);
    const TraceStatus status = status_of(slot->memory.error());
    if (status == trace_ok) made = std::move(slot);
    return status;
}

TraceStatus launch(const TraceCall& call, Query kind, const void* kernel, void* values) noexcept {
    const auto* target = static_cast<const Target*>(call.device);
    const bool made = target != nullptr && target->made != nullptr;
    const bool well_formed = (call.scene != nullptr || target != nullptr) &&
                             (call.rays != nullptr || made) && call.hits != nullptr &&
                             call.hits_max >= 1 && call.hits_max <= multi_hits_max &&
                             (kind != query_multi || call.hit_counts != nullptr);
    if (!well_formed) return trace_bad_call;
    if (call.ray_count == 0) return trace_ok;
    if (target != nullptr) return queue(*target, call, kind, kernel, values);
    try {
        return run_alone(call, kind, kernel, values);
    } catch (const std::bad_alloc&) {
        return out_of_host_memory();
    }
}

}  // namespace raynest::cuda
