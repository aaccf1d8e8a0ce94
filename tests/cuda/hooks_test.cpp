// Checks that the GPU traversal calls an intersector's hooks for boxes, primitives and instances,
// at every level, for every query, and that refused primitives are not hit. conformance only tests
// the intersectors of the list, none of which has a hook for boxes.
#include "engine/assets/builtin/builtin.h"
#include "engine/cuda/compress.h"
#include "engine/cuda/traverse.h"
#include "engine/intersectors/opaque.h"
#include "engine/queries/queries.h"
#include "engine/queries/reference.h"
#include "engine/scene/snapshot.h"
#include "tests/conformance/scenes.h"
#include "tests/cuda/binary_trees.h"

#include <doctest/doctest.h>

#include <array>
#include <cstdint>
#include <cstring>
#include <memory>
#include <utility>
#include <vector>

using namespace raynest;

namespace {

/// Cuts away everything above a plane in world space; a rising ray skips boxes that it enters above
/// the plane. Refuses to enter every fifth instance.
struct Section {
    std::array<std::uint32_t, 4>& boxes_at;  ///< calls, by number of instances on the way
    std::uint32_t& primitives;
    std::uint32_t& instances;

    auto operator()(const auto& ray, const BoxLike auto& boxes) {
        auto spans = intersect(ray, boxes);
        ++boxes_at[level_of(ray)];
        if (ray.world->direction.y > 0) {
            spans.keep_if(
                [&](const EnteredBox& box) { return ray.world_at(box.near).y <= height; });
        }
        return spans;
    }
    auto operator()(const auto& ray, const PrimitiveLike auto& primitive) {
        auto hits = intersect(ray, primitive);
        ++primitives;
        hits.keep_if([&](const Surface& hit) { return ray.world_at(hit.t).y <= height; });
        return hits;
    }
    bool operator()(const auto& /*ray*/, const InstanceLike auto& instance) {
        ++instances;
        return instance.index % 5 != 4;
    }

private:
    static constexpr float height = 0.5F;
    static std::uint32_t level_of(const auto& ray) {
        const SceneView& scene = *ray.scene;
        return scene.objects[scene.root].levels - ray.object->levels;
    }
};

template <class Query>
bool same(const Query& a, const Query& b) {
    if constexpr (requires { a.best; }) {
        return std::memcmp(&a.best, &b.best, sizeof a.best) == 0;
    } else if constexpr (requires { a.found; }) {
        return a.found == b.found;
    } else {
        return a.count == b.count &&
               std::memcmp(a.nearest.data(), b.nearest.data(), a.count * sizeof(HitRecord)) == 0;
    }
}

struct CompareCounts {
    std::array<std::uint32_t, 4> boxes_at{};
    std::uint32_t primitives = 0;
    std::uint32_t instances = 0;
    std::uint32_t different = 0;
    std::uint32_t hits = 0;
};

/// Traces rays through `trees` and through the reference; make(room) returns an empty query.
template <class Trees, class Make>
CompareCounts compare(const SceneView& scene, const Trees& trees, const std::vector<Ray>& rays,
                      Make&& make) {
    CompareCounts counts;
    CompareCounts ignored;
    Section isect{counts.boxes_at, counts.primitives, counts.instances};
    Section oracle{ignored.boxes_at, ignored.primitives, ignored.instances};
    std::array<HitRecord, 4> room, other_room;
    for (const Ray& ray : rays) {
        RayView view = outermost_view(ray, &scene, 0, 0xFFFFFFFFU, 0);
        view.object = &scene.objects[scene.root];
        auto query = make(room);
        CHECK(cuda::traverse_levels(view, trees, isect, query));
        auto expected = make(other_room);
        brute_force(view, Bvh{&scene, scene.root}, oracle, expected);
        counts.different += same(query, expected) ? 0U : 1U;
        if constexpr (requires { query.found; }) counts.hits += query.found ? 1U : 0U;
        if constexpr (requires { query.best; }) counts.hits += query.best.hit;
        if constexpr (requires { query.count; }) counts.hits += query.count;
    }
    return counts;
}

}  // namespace

TEST_CASE("hooks are called at every level by every query on both layouts") {
    for (const std::uint32_t depth : {1U, 2U, 3U, 4U}) {
        CAPTURE(depth);
        const SceneDescription description = conformance::nested_scene(depth, 3);
        const auto snapshot = Snapshot::build(description);
        REQUIRE(snapshot.has_value());
        const SceneView& scene = (*snapshot)->view();
        conformance::Random random(depth);
        const std::vector<Ray> rays = conformance::edge_rays(description, 600, 8, random);
        const auto trees = cuda::compress(scene);
        REQUIRE(trees.has_value());
        const auto check = [&](auto&& make) {
            for (const CompareCounts& counts :
                 {compare(scene, trees->view(), rays, make),
                  compare(scene, cuda::BinaryTrees(scene), rays, make)}) {
                CHECK(counts.different == 0);
                CHECK(counts.hits > 20);
                CHECK(counts.primitives > 0);
                CHECK((counts.instances > 0) == (depth > 1));
                for (std::uint32_t level = 0; level < depth; ++level) {
                    CHECK(counts.boxes_at[level] > 0);
                }
            }
        };
        using Room = std::array<HitRecord, 4>;
        check([](Room&) { return ClosestHit{}; });
        check([](Room&) { return AnyHit{}; });
        check([](Room& room) { return MultiHit{room}; });
    }
}

namespace {

SceneDescription spheres(std::size_t count) {
    ObjectDescription object;
    object.record_type = "sphere";
    object.records.resize(count * sizeof(Vec4));
    for (std::size_t i = 0; i < count; ++i) {
        const Vec3 center(4 * static_cast<float>(i), 0, 0);
        const Vec4 sphere(center, 1);
        std::memcpy(object.records.data() + i * sizeof sphere, &sphere, sizeof sphere);
        object.record_bounds.push_back({center - Vec3(1), center + Vec3(1)});
    }
    SceneDescription scene;
    scene.objects.push_back(std::move(object));
    return scene;
}

/// A scene, and rays through it from one point.
class RayFrom {
public:
    explicit RayFrom(const SceneDescription& description)
        : snapshot_(*Snapshot::build(description)),
          trees_(*cuda::compress(snapshot_->view())) {}

    [[nodiscard]] bool is_answered(const Vec3& direction, auto query) const {
        const SceneView& scene = snapshot_->view();
        Ray ray;
        ray.origin = Vec3(5);
        ray.direction = direction;
        RayView view = outermost_view(ray, &scene, 0, 0xFFFFFFFFU, 0);
        view.object = &scene.objects[scene.root];
        Opaque isect;
        return cuda::traverse_levels(view, trees_.view(), isect, query);
    }

private:
    const std::shared_ptr<const Snapshot> snapshot_;
    const cuda::DeviceTrees trees_;
};

/// Too short to tell one box from another: the ray meets everything in a scene.
const Vec3 endless(-1e-45F);

}  // namespace

TEST_CASE("a ray that meets everything in a scene exceeds the step limit, one that hits does not") {
    const RayFrom flake(*describe_builtin("builtin:flake?depth=8"));
    std::array<HitRecord, 4> room;
    CHECK_FALSE(flake.is_answered(endless, ClosestHit{}));
    CHECK_FALSE(flake.is_answered(endless, AnyHit{}));
    CHECK_FALSE(flake.is_answered(endless, MultiHit{room}));
    CHECK(flake.is_answered(Vec3(-1), ClosestHit{}));
    CHECK(flake.is_answered(Vec3(-1), AnyHit{}));
    CHECK(flake.is_answered(Vec3(-1), MultiHit{room}));
}

TEST_CASE("every triangle and record that a ray is tested against is a step of it") {
    // Half as many nodes and leaves stay below the limit.
    CHECK_FALSE(
        RayFrom(*describe_builtin("builtin:terrain?size=384")).is_answered(endless, AnyHit{}));
    CHECK(RayFrom(*describe_builtin("builtin:terrain?size=256")).is_answered(endless, AnyHit{}));
    CHECK_FALSE(RayFrom(spheres(cuda::ray_steps_max)).is_answered(endless, AnyHit{}));
    CHECK(RayFrom(spheres(cuda::ray_steps_max / 2)).is_answered(endless, AnyHit{}));
}
