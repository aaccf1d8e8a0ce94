#include "engine/cuda/compress.h"
#include "engine/cuda/launch.h"
#include "engine/geometry/record_types.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <new>
#include <vector>

namespace raynest {
namespace cuda {
namespace {

// What one call keeps on the device. Remembers the first thing that went wrong, so that a caller
// asks once, at the end.
class DeviceMemory {
public:
    explicit DeviceMemory(cudaStream_t stream) : stream_(stream) {}
    DeviceMemory(const DeviceMemory&) = delete;
    DeviceMemory& operator=(const DeviceMemory&) = delete;
    ~DeviceMemory() {
        for (void* block : blocks_) cudaFreeAsync(block, stream_);
    }

    template <class T>
    T* room(std::uint64_t count) {
        void* block = nullptr;
        if (count == 0 || error_ != cudaSuccess) return nullptr;
        check(cudaMallocAsync(&block, count * sizeof(T), stream_));
        if (block != nullptr) blocks_.push_back(block);
        return static_cast<T*>(block);
    }
    template <class T>
    const T* copy(const T* from, std::uint64_t count) {
        T* to = room<T>(count);
        if (to != nullptr) {
            check(cudaMemcpyAsync(to, from, count * sizeof(T), cudaMemcpyHostToDevice, stream_));
        }
        return to;
    }
    template <class T>
    void bring(T* to, const T* from, std::uint64_t count) {
        if (from == nullptr || error_ != cudaSuccess) return;
        check(cudaMemcpyAsync(to, from, count * sizeof(T), cudaMemcpyDeviceToHost, stream_));
    }
    void check(cudaError_t error) {
        if (error_ == cudaSuccess) error_ = error;
    }
    [[nodiscard]] cudaError_t error() const { return error_; }

private:
    cudaStream_t stream_;
    std::vector<void*> blocks_;
    cudaError_t error_ = cudaSuccess;
};

// How far kernels read into `attributes`: the view does not say how long it is.
std::uint64_t attribute_bytes(const SceneView& scene) {
    std::uint64_t end = 0;
    const auto reach = [&](std::uint64_t offset, std::uint64_t bytes) {
        if (offset != no_offset) end = std::max(end, offset + bytes);
    };
    for (std::uint32_t i = 0; i < scene.geometry_count; ++i) {
        const GeometryRecord& geometry = scene.geometries[i];
        reach(geometry.indices, 12 * std::uint64_t{geometry.triangle_count});
        for (const std::uint64_t set : geometry.texcoords) {
            reach(set, 8 * std::uint64_t{geometry.vertex_count});
        }
        reach(geometry.colours, 4 * std::uint64_t{geometry.vertex_count});
        reach(geometry.opacity, sizeof(Opacity) * std::uint64_t{geometry.triangle_count});
    }
    for (std::uint32_t i = 0; i < scene.texture_count; ++i) {
        const TextureRecord& texture = scene.textures[i];
        reach(texture.alpha, std::uint64_t{texture.width} * texture.height);
    }
    return end;
}

std::uint64_t record_bytes(const SceneView& scene) {
    std::uint64_t end = 0;
    for (std::uint32_t o = 0; o < scene.object_count; ++o) {
        const ObjectRecord& object = scene.objects[o];
        if (object.record_count == 0) continue;
        end = std::max(end, object.first_record + records_bytes(object));
    }
    return end;
}

// The arrays that kernels read, and a view of them.
const SceneView* copy_scene(const SceneView& scene, DeviceMemory& memory) {
    SceneView view = scene;
    view.nodes = nullptr;
    view.blocks = nullptr;
    view.instance_infos = nullptr;
    view.cameras = nullptr;
    view.names = nullptr;
    view.records = memory.copy(scene.records, record_bytes(scene));
    view.objects = memory.copy(scene.objects, scene.object_count);
    view.instances = memory.copy(scene.instances, scene.instance_count);
    view.geometries = memory.copy(scene.geometries, scene.geometry_count);
    view.materials = memory.copy(scene.materials, scene.material_count);
    view.textures = memory.copy(scene.textures, scene.texture_count);
    view.attributes = memory.copy(scene.attributes, attribute_bytes(scene));
    return memory.copy(&view, 1);
}

TraceStatus status_of(cudaError_t error) {
    switch (error) {
        case cudaSuccess:
            return trace_ok;
        case cudaErrorMemoryAllocation:
            return trace_out_of_memory;
        default:
            return trace_no_device;
    }
}

TraceStatus launch_on(cudaStream_t stream, const TraceCall& call, Query kind, const void* kernel,
                      void* values) {
    const auto trees = compress(*call.scene);
    if (!trees) return trace_too_deep;
    const std::uint64_t hit_count = std::uint64_t{call.ray_count} * call.hits_max;

    DeviceMemory memory(stream);
    TraceCall device = call;
    device.scene = copy_scene(*call.scene, memory);
    device.params = nullptr;
    device.rays = memory.copy(call.rays, call.ray_count);
    device.hits = memory.room<HitRecord>(hit_count);
    device.hit_counts = kind == query_multi ? memory.room<std::uint32_t>(call.ray_count) : nullptr;
    // Behind a ray's last hit nothing is written, and what lay there before is nobody's business.
    if (kind == query_multi && memory.error() == cudaSuccess) {
        memory.check(cudaMemsetAsync(device.hits, 0, hit_count * sizeof(HitRecord), stream));
    }
    CompressedTrees device_trees{memory.copy(trees->nodes.data(), trees->nodes.size()),
                                 memory.copy(trees->triangles.data(), trees->triangles.size())};

    void* arguments[] = {&device, &device_trees, values};
    const std::uint32_t blocks = (call.ray_count + block_rays - 1) / block_rays;
    if (memory.error() == cudaSuccess) {
        memory.check(
            cudaLaunchKernel(kernel, dim3(blocks), dim3(block_rays), arguments, 0, stream));
    }
    memory.bring(call.hits, device.hits, hit_count);
    if (kind == query_multi) memory.bring(call.hit_counts, device.hit_counts, call.ray_count);
    memory.check(cudaStreamSynchronize(stream));
    return status_of(memory.error());
}

}  // namespace

TraceStatus launch(const TraceCall& call, Query kind, const void* kernel, void* values) noexcept {
    const bool well_formed = call.scene != nullptr && call.rays != nullptr &&
                             call.hits != nullptr && call.hits_max >= 1 &&
                             call.hits_max <= multi_hits_max &&
                             (kind != query_multi || call.hit_counts != nullptr);
    if (!well_formed) return trace_bad_call;
    if (call.ray_count == 0) return trace_ok;
    cudaStream_t stream = nullptr;
    const cudaError_t error = cudaStreamCreateWithFlags(&stream, cudaStreamNonBlocking);
    if (error != cudaSuccess) return status_of(error);
    TraceStatus status = trace_out_of_memory;
    try {
        status = launch_on(stream, call, kind, kernel, values);
    } catch (const std::bad_alloc&) {
        // Of the host: said as of the device.
    }
    cudaStreamDestroy(stream);
    return status;
}

}  // namespace cuda

bool is_supported() noexcept {
    int count = 0;
    return cudaGetDeviceCount(&count) == cudaSuccess && count > 0;
}

}  // namespace raynest
