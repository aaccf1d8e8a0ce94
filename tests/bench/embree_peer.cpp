#include "tests/bench/peer.h"

#include <limits>
#include <map>
#include <vector>

#ifdef RAYNEST_EMBREE
#include <embree3/rtcore.h>

namespace raynest::bench {
namespace {

class Embree final : public Peer {
public:
    explicit Embree(const SceneDescription& scene)
        : device_(rtcNewDevice("threads=1,set_affinity=0,frequency_level=simd512,hugepages=1")),
          root_(rtcNewScene(device_)) {
        const bool flat = scene.objects.size() == 1;
        place(scene, scene.root, Transform{}, flat);
        rtcCommitScene(root_);
    }
    Embree(const Embree&) = delete;
    Embree& operator=(const Embree&) = delete;
    ~Embree() override {
        for (const auto& [object, mesh] : meshes_) rtcReleaseScene(mesh);
        rtcReleaseScene(root_);
        rtcReleaseDevice(device_);
    }

    [[nodiscard]] std::string name() const override {
        return "embree " +
               std::to_string(rtcGetDeviceProperty(device_, RTC_DEVICE_PROPERTY_VERSION));
    }

    void closest(std::span<const Ray> rays, std::span<float> t) override {
        RTCIntersectContext context;
        rtcInitIntersectContext(&context);
        for (std::size_t i = 0; i < rays.size(); ++i) {
            RTCRayHit query;
            fill(query.ray, rays[i]);
            query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
            query.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
            rtcIntersect1(root_, &context, &query);
            t[i] = query.hit.geomID == RTC_INVALID_GEOMETRY_ID
                       ? std::numeric_limits<float>::infinity()
                       : query.ray.tfar;
        }
    }

    void any(std::span<const Ray> rays, std::span<float> t) override {
        RTCIntersectContext context;
        rtcInitIntersectContext(&context);
        for (std::size_t i = 0; i < rays.size(); ++i) {
            RTCRay query;
            fill(query, rays[i]);
            rtcOccluded1(root_, &context, &query);
            t[i] = query.tfar < 0 ? 0 : std::numeric_limits<float>::infinity();
        }
    }

private:
    static void fill(RTCRay& out, const Ray& ray) {
        out.org_x = ray.origin.x;
        out.org_y = ray.origin.y;
        out.org_z = ray.origin.z;
        out.tnear = ray.tmin;
        out.dir_x = ray.direction.x;
        out.dir_y = ray.direction.y;
        out.dir_z = ray.direction.z;
        out.tfar = ray.tmax;
        out.time = 0;
        out.mask = 0xFFFFFFFFU;
        out.id = 0;
        out.flags = 0;
    }

    void add_triangles(RTCScene into, const ObjectDescription& object) {
        for (const GeometryDescription& geometry : object.geometries) {
            RTCGeometry mesh = rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_TRIANGLE);
            auto* vertices = static_cast<Vec3*>(
                rtcSetNewGeometryBuffer(mesh, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                        sizeof(Vec3), geometry.positions.size()));
            std::copy(geometry.positions.begin(), geometry.positions.end(), vertices);
            auto* indices = static_cast<std::uint32_t*>(
                rtcSetNewGeometryBuffer(mesh, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                        3 * sizeof(std::uint32_t), geometry.indices.size() / 3));
            std::copy(geometry.indices.begin(), geometry.indices.end(), indices);
            rtcCommitGeometry(mesh);
            rtcAttachGeometry(into, mesh);
            rtcReleaseGeometry(mesh);
        }
    }

    RTCScene mesh_of(const SceneDescription& scene, std::uint32_t object) {
        RTCScene& mesh = meshes_[object];
        if (mesh == nullptr) {
            mesh = rtcNewScene(device_);
            add_triangles(mesh, scene.objects[object]);
            rtcCommitScene(mesh);
        }
        return mesh;
    }

    void place(const SceneDescription& scene, std::uint32_t index, const Transform& to_world,
               bool flat) {
        const ObjectDescription& object = scene.objects[index];
        if (flat) {
            add_triangles(root_, object);
        } else if (!object.geometries.empty()) {
            RTCGeometry instance = rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_INSTANCE);
            rtcSetGeometryInstancedScene(instance, mesh_of(scene, index));
            rtcSetGeometryTransform(instance, 0, RTC_FORMAT_FLOAT3X4_ROW_MAJOR, to_world.m.data());
            rtcCommitGeometry(instance);
            rtcAttachGeometry(root_, instance);
            rtcReleaseGeometry(instance);
        }
        for (const InstanceDescription& instance : object.instances) {
            const Transform down = compose(to_world, instance.transform);
            Transform inverse;
            if (!invert(down, inverse)) continue;  // its asserts abort on a singular transform
            place(scene, instance.object, down, false);
        }
    }

    RTCDevice device_;
    RTCScene root_;
    std::map<std::uint32_t, RTCScene> meshes_;
};

}  // namespace

Result<std::unique_ptr<Peer>> make_embree(const SceneDescription& scene) {
    return std::unique_ptr<Peer>(std::make_unique<Embree>(scene));
}

}  // namespace raynest::bench

#else

namespace raynest::bench {

Result<std::unique_ptr<Peer>> make_embree(const SceneDescription& /*scene*/) {
    return fail(ErrorCode::variant_unknown,
                "this build has no Embree: install libembree-dev and configure again");
}

}  // namespace raynest::bench

#endif
