#include "tests/bench/embree/tree.h"

#include <algorithm>
#include <string>

namespace raynest::bench {
namespace {

bool is_masked(const SceneView& view, const GeometryRecord& geometry) {
    return geometry.material != no_id &&
           view.materials[geometry.material].alpha_mode != AlphaMode::opaque;
}

template <class T>
void copy_buffer(RTCGeometry mesh, RTCBufferType type, RTCFormat format, const T* from,
                 std::size_t count, std::size_t values_per_element) {
    const std::size_t size = sizeof(T) * values_per_element;
    auto* to = static_cast<T*>(rtcSetNewGeometryBuffer(mesh, type, 0, format, size, count));
    std::copy_n(from, count * values_per_element, to);
}

}  // namespace

Result<std::unique_ptr<EmbreeTree>> EmbreeTree::make(const SceneView& view, const TreeForm& form,
                                                     unsigned threads) {
    const std::span<const ObjectRecord> objects(view.objects, view.object_count);
    if (std::any_of(objects.begin(), objects.end(),
                    [](const ObjectRecord& object) { return object.record_count != 0; })) {
        return fail(ErrorCode::scene_unsupported,
                    "the peer is given triangles and instances only; this scene has records");
    }
    std::unique_ptr<EmbreeTree> tree(new EmbreeTree(view, form, threads));
    const ObjectRecord& root = view.objects[view.root];
    tree->add_triangles(tree->root_, root);
    if (form.instances) tree->place_children(view.root, Transform{});
    if (const RTCError error = rtcGetDeviceError(tree->device_); error != RTC_ERROR_NONE) {
        return fail(ErrorCode::internal, "Embree error " + std::to_string(error));
    }
    return tree;
}

EmbreeTree::EmbreeTree(const SceneView& view, const TreeForm& form, unsigned threads)
    : view_(view),
      form_(form),
      device_(rtcNewDevice((device_options + std::to_string(threads)).c_str())) {
    rtcSetDeviceMemoryMonitorFunction(
        device_,
        [](void* sum, ssize_t bytes, bool) {
            __atomic_fetch_add(static_cast<std::int64_t*>(sum), bytes, __ATOMIC_RELAXED);
            return true;
        },
        &reported_bytes_);
    root_ = new_scene();
}

EmbreeTree::~EmbreeTree() {
    for (const auto& [object, mesh] : meshes_) rtcReleaseScene(mesh);
    rtcReleaseScene(root_);
    rtcReleaseDevice(device_);
}

void EmbreeTree::commit() {
    rtcCommitScene(root_);
}

RTCScene EmbreeTree::new_scene() {
    RTCScene scene = rtcNewScene(device_);
    rtcSetSceneBuildQuality(scene, form_.quality);
    rtcSetSceneFlags(scene,
                     static_cast<RTCSceneFlags>(
                         (form_.robust ? RTC_SCENE_FLAG_ROBUST : RTC_SCENE_FLAG_NONE) |
                         (form_.filter_in_query ? argument_filter_flag : RTC_SCENE_FLAG_NONE)));
    return scene;
}

void EmbreeTree::set_filter(RTCGeometry mesh, const GeometryRecord& geometry) {
    if (form_.filter == nullptr || !(form_.filter_all || is_masked(view_, geometry))) return;
    const MaterialRecord* material =
        geometry.material != no_id ? &view_.materials[geometry.material] : nullptr;
    masked_.push_back(
        std::make_unique<MaskedGeometry>(MaskedGeometry{&view_, &geometry, material}));
    rtcSetGeometryUserData(mesh, masked_.back().get());
    if (form_.filter_in_query) {
        take_argument_filter(mesh);
    } else {
        rtcSetGeometryIntersectFilterFunction(mesh, form_.filter);
        rtcSetGeometryOccludedFilterFunction(mesh, form_.filter);
    }
}

void EmbreeTree::add_triangles(RTCScene into, const ObjectRecord& object) {
    for (std::uint32_t i = 0; i < object.geometry_count; ++i) {
        const GeometryRecord& geometry = view_.geometries[object.first_geometry + i];
        RTCGeometry mesh = rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_TRIANGLE);
        rtcSetGeometryBuildQuality(mesh, form_.quality);
        copy_buffer(mesh, RTC_BUFFER_TYPE_VERTEX, RTC_FORMAT_FLOAT3,
                    view_.attribute<float>(geometry.positions), geometry.vertex_count, 3);
        copy_buffer(mesh, RTC_BUFFER_TYPE_INDEX, RTC_FORMAT_UINT3,
                    view_.attribute<std::uint32_t>(geometry.indices), geometry.triangle_count, 3);
        set_filter(mesh, geometry);
        rtcCommitGeometry(mesh);
        rtcAttachGeometry(into, mesh);
        rtcReleaseGeometry(mesh);
    }
}

RTCScene EmbreeTree::mesh_of(std::uint32_t object) {
    RTCScene& mesh = meshes_[object];
    if (mesh == nullptr) {
        mesh = new_scene();
        add_triangles(mesh, view_.objects[object]);
        rtcCommitScene(mesh);
    }
    return mesh;
}

void EmbreeTree::place(std::uint32_t object, const Transform& to_world) {
    if (view_.objects[object].triangle_count != 0) {
        RTCGeometry instance = rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_INSTANCE);
        rtcSetGeometryInstancedScene(instance, mesh_of(object));
        rtcSetGeometryTransform(instance, 0, RTC_FORMAT_FLOAT3X4_ROW_MAJOR, to_world.m.data());
        rtcCommitGeometry(instance);
        rtcAttachGeometry(root_, instance);
        rtcReleaseGeometry(instance);
        placed_.push_back(object);
    }
    place_children(object, to_world);
}

void EmbreeTree::place_children(std::uint32_t object, const Transform& to_world) {
    const ObjectRecord& record = view_.objects[object];
    for (std::uint32_t i = 0; i < record.instance_count; ++i) {
        const std::uint32_t index = record.first_instance + i;
        place(view_.instances[index].object,
              compose(to_world, view_.instance_infos[index].to_parent));
    }
}

void EmbreeTree::translate(std::span<HitRecord> hits) const {
    const ObjectRecord& root = view_.objects[view_.root];
    for (HitRecord& hit : hits) {
        if (hit.hit == 0) continue;
        const auto instance = static_cast<std::uint32_t>(hit.path);
        const std::uint32_t geometry = hit.object;
        if (instance == RTC_INVALID_GEOMETRY_ID) {
            hit.path = 0;
            hit.object = view_.root;
        } else {
            // Own triangles take path 0 and the first geometry ids, instances what follows.
            const std::uint32_t place = instance - root.geometry_count;
            hit.path = place + (root.triangle_count != 0 ? 1U : 0U);
            hit.object = placed_[place];
        }
        hit.triangle +=
            view_.geometries[view_.objects[hit.object].first_geometry + geometry].first_triangle;
    }
}

}  // namespace raynest::bench
