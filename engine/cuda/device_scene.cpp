#include "engine/cuda/device_scene.h"

#include "engine/cuda/compress.h"
#include "engine/cuda/status.h"
#include "engine/geometry/record_types.h"

#include <algorithm>
#include <utility>

namespace raynest::cuda {
namespace {

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

// Copies the arrays that kernels read, and returns a view of them.
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

}  // namespace

TraceStatus copy_to_device(const SceneView& scene, std::unique_ptr<DeviceScene>& loaded) {
    const auto trees = compress(scene);
    if (!trees) return trace_too_deep;
    auto to = std::make_unique<DeviceScene>();
    DeviceMemory& memory = to->memory;
    to->view = copy_scene(scene, memory);
    to->trees = {memory.copy(trees->nodes.data(), trees->nodes.size()),
                 memory.copy(trees->triangles.data(), trees->triangles.size())};
    // The slots' streams do not wait for this one.
    if (const TraceStatus status = status_of(memory.error()); status != trace_ok) return status;
    if (const TraceStatus status = status_of(cudaStreamSynchronize(nullptr)); status != trace_ok)
        return status;
    loaded = std::move(to);
    return trace_ok;
}

}  // namespace raynest::cuda
