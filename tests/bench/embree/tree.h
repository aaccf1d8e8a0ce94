// A built scene as Embree scenes: the root's own triangles and its instances in one scene.
//
// Debian's Embree knows one level of instances, so deeper scenes are given as the list of their
// leaf placements, in the order of our path ids.
#pragma once

#include "engine/geometry/hit.h"
#include "engine/geometry/views.h"
#include "engine/result.h"
#include "tests/bench/embree/api.h"

#include <cstdint>
#include <map>
#include <memory>
#include <span>
#include <vector>

namespace raynest::bench {

/// The data that the filter of a masked geometry needs.
struct MaskedGeometry {
    const SceneView* scene;
    const GeometryRecord* geometry;
    const MaterialRecord* material;
};

/// How a scene is built.
struct TreeForm {
    RTCBuildQuality quality = RTC_BUILD_QUALITY_MEDIUM;
    bool robust = false;
    bool instances = true;                ///< else the root's own triangles only
    RTCFilterFunctionN filter = nullptr;  ///< called for candidates on filtered geometries
    bool filter_all = false;              ///< else masked geometries only
    bool filter_in_query = false;         ///< the query carries the filter, not the geometry

    bool operator==(const TreeForm&) const = default;
};

class EmbreeTree {
public:
    /// Fails for primitives other than triangles. The root is not committed yet.
    static Result<std::unique_ptr<EmbreeTree>> make(const SceneView& view, const TreeForm& form,
                                                    unsigned threads);
    EmbreeTree(const EmbreeTree&) = delete;
    EmbreeTree& operator=(const EmbreeTree&) = delete;
    ~EmbreeTree();

    void commit();
    [[nodiscard]] RTCScene root() const { return root_; }
    /// Returns the bytes allocated so far, by the device's own monitor.
    [[nodiscard]] std::int64_t reported_bytes() const { return reported_bytes_; }
    /// (path, object, triangle) from (instID, geomID, primID).
    void translate(std::span<HitRecord> hits) const;

private:
    EmbreeTree(const SceneView& view, const TreeForm& form, unsigned threads);
    RTCScene new_scene();
    void add_triangles(RTCScene into, const ObjectRecord& object);
    void set_filter(RTCGeometry mesh, const GeometryRecord& geometry);
    RTCScene mesh_of(std::uint32_t object);
    void place(std::uint32_t object, const Transform& to_world);
    void place_children(std::uint32_t object, const Transform& to_world);

    const SceneView& view_;
    TreeForm form_;
    std::int64_t reported_bytes_ = 0;
    RTCDevice device_;
    RTCScene root_;
    std::map<std::uint32_t, RTCScene> meshes_;  ///< by object
    std::vector<std::uint32_t> placed_;         ///< object per instance of the root
    std::vector<std::unique_ptr<MaskedGeometry>> masked_;
};

}  // namespace raynest::bench
