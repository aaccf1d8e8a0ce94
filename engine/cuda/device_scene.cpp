#include "engine/cuda/device_scene.h"

#include "engine/cuda/compress.h"
#include "engine/cuda/status.h"
#include "engine/geometry/record_types.h"

#include <cuda_runtime_api.h>

#include <algorithm>
#include <atomic>
#include <span>
#include <utility>
#include <vector>

namespace raynest::cuda {
namespace {

std::atomic<std::uint64_t> bytes_on_device = 0;

/// Bytes of an element on the device, by SceneArray: of a node compressed, of a leaf block its
/// triangles.
constexpr std::array<std::uint64_t, array_count> element_bytes{
    sizeof(CompressedNode), 8 * sizeof(DeviceTriangle), 1,
    sizeof(ObjectRecord),   sizeof(InstanceRecord),     sizeof(GeometryRecord),
    sizeof(MaterialRecord), sizeof(TextureRecord),      1};

// Returns how far kernels read into `attributes`; the view does not store its length.
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

/// Fills a scene's arrays. Keeps the first error and does nothing after it.
class Copy {
public:
    explicit Copy(DeviceScene& to) : to_(to) {}

    /// Copies elements as the device stores them.
    void put(std::uint32_t array, std::uint64_t first, const void* elements, std::uint64_t count) {
        const std::uint64_t bytes = element_bytes[array];
        put_bytes(to_.arrays[array], first * bytes, elements, count * bytes);
    }
    /// Copies elements as an arena stores them.
    void convert(const ChangedRange& range) {
        if (range.array == array_nodes)
            put(range, compress(elements_of<Node>(range)));
        else if (range.array == array_blocks)
            put(range, compress(elements_of<TriangleBlock>(range)));
        else
            put(range.array, range.first, range.elements, range.count);
    }
    void whole(std::uint32_t array, const void* elements, std::uint64_t count) {
        to_.arrays[array] = room(count, element_bytes[array]);
        put(array, 0, elements, count);
    }
    /// Copies an array that is on the device.
    void duplicate(std::uint32_t array, const DeviceArray& from) {
        const std::uint64_t bytes = from.count * element_bytes[array];
        to_.arrays[array] = room(from.count, element_bytes[array]);
        if (error_ == cudaSuccess && bytes != 0)
            error_ = cudaMemcpy(to_.arrays[array].data.get(), from.data.get(), bytes,
                                cudaMemcpyDeviceToDevice);
    }
    /// Makes the scene's view, once all arrays are there, and waits for the copies.
    TraceStatus finish(const SceneView& counts) {
        SceneView& view = to_.on_host = counts;
        view.nodes = nullptr;
        view.blocks = nullptr;
        view.instance_infos = nullptr;
        view.cameras = nullptr;
        view.names = nullptr;
        point(view.records, array_records);
        point(view.objects, array_objects);
        point(view.instances, array_instances);
        point(view.geometries, array_geometries);
        point(view.materials, array_materials);
        point(view.textures, array_textures);
        point(view.attributes, array_attributes);
        point(to_.trees.nodes, array_nodes);
        point(to_.trees.triangles, array_blocks);
        to_.view_array = room(1, sizeof view);
        put_bytes(to_.view_array, 0, &view, sizeof view);
        to_.view = reinterpret_cast<const SceneView*>(to_.view_array.data.get());
        // The slots' streams do not wait for this one.
        if (error_ == cudaSuccess) error_ = cudaStreamSynchronize(nullptr);
        return status_of(error_);
    }

private:
    DeviceArray room(std::uint64_t count, std::uint64_t element) {
        const std::uint64_t bytes = count * element;
        void* block = nullptr;
        if (bytes == 0 || error_ != cudaSuccess) return {};
        error_ = cudaMalloc(&block, bytes);
        if (error_ != cudaSuccess) return {};
        bytes_on_device += bytes;
        const auto free = [bytes](std::byte* data) {
            cudaFree(data);
            bytes_on_device -= bytes;
        };
        return {std::shared_ptr<std::byte>(static_cast<std::byte*>(block), free), count};
    }
    void put_bytes(const DeviceArray& array, std::uint64_t at, const void* from,
                   std::uint64_t bytes) {
        if (bytes == 0 || error_ != cudaSuccess) return;
        error_ = cudaMemcpy(array.data.get() + at, from, bytes, cudaMemcpyHostToDevice);
        to_.copied_bytes += bytes;
    }
    template <class T>
    void put(const ChangedRange& range, const std::vector<T>& converted) {
        put(range.array, range.first, converted.data(), range.count);
    }
    template <class T>
    static std::span<const T> elements_of(const ChangedRange& range) {
        return {static_cast<const T*>(range.elements), range.count};
    }
    template <class T>
    void point(const T*& pointer, std::uint32_t array) const {
        pointer = reinterpret_cast<const T*>(to_.arrays[array].data.get());
    }

    DeviceScene& to_;
    cudaError_t error_ = cudaSuccess;
};

}  // namespace

TraceStatus copy_to_device(const SceneView& scene, std::unique_ptr<DeviceScene>& loaded) {
    const auto trees = compress(scene);
    if (!trees) return trace_too_deep;
    auto to = std::make_unique<DeviceScene>();
    Copy copy(*to);
    copy.whole(array_nodes, trees->nodes.data(), trees->nodes.size());
    copy.whole(array_blocks, trees->triangles.data(), trees->triangles.size() / 8);
    copy.whole(array_records, scene.records, record_bytes(scene));
    copy.whole(array_objects, scene.objects, scene.object_count);
    copy.whole(array_instances, scene.instances, scene.instance_count);
    copy.whole(array_geometries, scene.geometries, scene.geometry_count);
    copy.whole(array_materials, scene.materials, scene.material_count);
    copy.whole(array_textures, scene.textures, scene.texture_count);
    copy.whole(array_attributes, scene.attributes, attribute_bytes(scene));
    const TraceStatus status = copy.finish(scene);
    if (status == trace_ok) loaded = std::move(to);
    return status;
}

TraceStatus copy_changed(const DeviceScene& base, std::span<const ChangedRange> ranges,
                         std::unique_ptr<DeviceScene>& loaded) {
    std::vector<ChangedRange> changes;
    std::array<bool, array_count> is_changed{};
    for (ChangedRange range : ranges) {
        if (range.array >= array_count) return trace_bad_call;
        const std::uint64_t count = base.arrays[range.array].count;
        // The device holds the attributes and records that kernels read, and none behind them.
        if (element_bytes[range.array] == 1) {
            if (range.first >= count) continue;
            range.count = std::min(range.count, count - range.first);
        }
        if (range.first > count || range.count > count - range.first) return trace_bad_call;
        is_changed[range.array] = true;
        changes.push_back(range);
    }
    auto to = std::make_unique<DeviceScene>();
    Copy copy(*to);
    for (std::uint32_t array = 0; array < array_count; ++array) {
        if (is_changed[array])
            copy.duplicate(array, base.arrays[array]);
        else
            to->arrays[array] = base.arrays[array];
    }
    for (const ChangedRange& range : changes) copy.convert(range);
    const TraceStatus status = copy.finish(base.on_host);
    if (status == trace_ok) loaded = std::move(to);
    return status;
}

std::uint64_t scene_bytes() noexcept {
    return bytes_on_device;
}

}  // namespace raynest::cuda
