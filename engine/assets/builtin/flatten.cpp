// Flattens nesting levels, so that the gain and the cost of instancing can be measured on equal
// triangles. Merging proceeds from the leaves of the object graph upwards.
#include "engine/assets/builtin/builtin.h"
#include "engine/scene/graph.h"

#include <fmt/format.h>

#include <algorithm>

namespace raynest {
namespace {

/// Appends `part`, moved by `transform`, to the geometries of `whole` that have the same material.
void merge(ObjectDescription& whole, const ObjectDescription& part, const Transform& transform) {
    for (const GeometryDescription& from : part.geometries) {
        auto to = std::find_if(whole.geometries.begin(), whole.geometries.end(),
                               [&](const auto& g) { return g.material == from.material; });
        if (to == whole.geometries.end()) {
            to = whole.geometries.insert(to, GeometryDescription{});
            to->material = from.material;
        }
        const auto base = static_cast<std::uint32_t>(to->positions.size());
        for (const Vec3& p : from.positions) to->positions.push_back(transform.point(p));
        for (const std::uint32_t index : from.indices) to->indices.push_back(base + index);
        to->texcoords[0].insert(to->texcoords[0].end(), from.texcoords[0].begin(),
                                from.texcoords[0].end());
    }
}

}  // namespace

Result<void> flatten_levels(SceneDescription& scene, std::uint32_t levels,
                            std::uint64_t triangles_max) {
    // Objects are listed children first. Depth from the root decides: an object at the last allowed
    // level absorbs everything below it.
    const std::size_t count = scene.objects.size();
    std::vector<std::uint32_t> depth(count, 0);
    depth[scene.root] = 1;
    for (std::size_t i = count; i-- > 0;) {
        for (const InstanceDescription& instance : scene.objects[i].instances) {
            depth[instance.object] = std::max(depth[instance.object], depth[i] + 1);
        }
    }
    std::uint64_t written = 0;
    for (std::size_t i = 0; i < count; ++i) {
        ObjectDescription& object = scene.objects[i];
        if (depth[i] < levels) continue;
        for (const InstanceDescription& instance : object.instances) {
            written += own_triangles(scene.objects[instance.object]);
            if (written > triangles_max) {
                return fail(
                    ErrorCode::limit_exceeded,
                    fmt::format("flattened to {} levels, the scene has more than {} triangles; "
                                "ask for more levels or fewer trees",
                                levels, triangles_max));
            }
            merge(object, scene.objects[instance.object], instance.transform);
        }
        object.instances.clear();
    }
    return {};
}

}  // namespace raynest
