// The building blocks of every traversal, with or without a tree: the visited types, the only place
// where surfaces are tested, and the transform into an instance.
#pragma once

#include "engine/bvh/intersect_with.h"
#include "engine/geometry/intersect_triangle.h"
#include "engine/geometry/record.h"
#include "engine/geometry/record_types.h"
#include "engine/geometry/views.h"

#include <cstddef>
#include <cstdint>

namespace raynest {

/// One object of a scene as a primitive: the tree over its triangles, records and instances.
struct Bvh {
    const SceneView* scene;
    std::uint32_t object;

    [[nodiscard]] RAYNEST_FN const ObjectRecord& record() const { return scene->objects[object]; }
    /// Leaf placements below: the step of path ids from one element of a list to the next.
    [[nodiscard]] std::uint64_t placement_count() const { return record().placement_count; }
};

/// One placement of an object, by its index in the scene's instances.
struct Instance {
    using instance_tag = void;
    const SceneView* scene;
    std::uint32_t index;

    [[nodiscard]] RAYNEST_FN const InstanceRecord& record() const {
        return scene->instances[index];
    }
    [[nodiscard]] std::uint64_t placement_count() const {
        return scene->objects[record().object].placement_count;
    }
};

/// Drops back faces of single-sided materials: `--set cull=back`.
template <class H>
RAYNEST_NOINLINE void drop_back_faces(const RayView& ray, H& hits) {
    hits.keep_if([&](const Surface& surface) {
        if (surface.front) return true;
        if (ray.object == nullptr || ray.object->triangle_count == 0) return false;
        const GeometryRecord& geometry = ray.scene->geometry_of(*ray.object, surface.prim);
        return geometry.material != no_id &&
               ray.scene->materials[geometry.material].double_sided != 0;
    });
}

/// A primitive: the one place where surfaces are tested.
template <class R, PrimitiveLike P, class Isect, class Query>
RAYNEST_INLINE bool visit(R& ray, const P& primitive, Isect& isect, Query& query) {
    auto hits = intersect_with(isect, ray, primitive);
    if (hits.mask == 0) [[likely]]
        return false;
    if (ray.flags != 0) [[unlikely]] {
        if constexpr (Query::ordered) {
            drop_back_faces(ray, hits);
        } else {
            // A copy, so that hits of which only the mask is read stay in registers, unfinished
            // (measured: 2 %; where all of them is read it costs 1).
            auto kept = hits;
            drop_back_faces(ray, kept);
            hits.mask = kept.mask;
        }
    }
    return query.take(ray, hits);
}

/// The ray as the instance's object sees it: same t, one level down.
[[nodiscard]] RAYNEST_INLINE RayView enter(const RayView& ray, const SceneView& scene,
                                           const InstanceRecord& instance) {
    // As Transform::point and ::direction do it, all rows at once.
    using F = Lanes<4>;
    F column[4];
    F::load_columns(column, instance.to_object);
    const auto turned = [&](const Vec3& v, const F& z) RAYNEST_INLINE_LAMBDA {
        return fused(column[0], F::splat(v.x), fused(column[1], F::splat(v.y), z)).to_vec3();
    };
    const F origin_z = fused(column[2], F::splat(ray.origin.z), column[3]);
    const F direction_z = column[2] * F::splat(ray.direction.z);
    // Member by member: a copied block would wait for the stores that it was written with.
    return {turned(ray.origin, origin_z),
            turned(ray.direction, direction_z),
            ray.tmin,
            ray.tmax,
            ray.world,
            &scene,
            &scene.objects[instance.object],
            ray.path + instance.path_base,
            ray.id,
            ray.mask,
            ray.flags,
            ray.level + 1};
}

/// visitor(Record<P>) for `count` records of the object from `first` on, with its own type of
/// primitive for P, until one call returns true; then so does this.
template <class Visitor>
RAYNEST_INLINE bool visit_record_type(const SceneView& scene, const ObjectRecord& object,
                                      std::uint32_t first, std::uint32_t count, Visitor&& visitor) {
    bool done = false;
    for_each_record_type([&]<class P>(RecordType<P> type) {
        if (object.record_type != type.id || done) return;
        constexpr std::size_t stride = sizeof(P) + sizeof(std::uint32_t);
        const std::byte* at = scene.records + object.first_record + stride * first;
        for (std::uint32_t i = 0; i < count && !done; ++i, at += stride) {
            std::uint32_t index;
            __builtin_memcpy(&index, at + sizeof(P), sizeof index);
            done = visitor(Record<P>{reinterpret_cast<const P*>(at), index, i == 0});
        }
    });
    return done;
}

}  // namespace raynest
