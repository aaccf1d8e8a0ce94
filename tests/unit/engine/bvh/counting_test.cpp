// Compares counters with a plain scalar traversal of the same tree: one box, one triangle at a
// time.
#include "engine/intersectors/counting.h"

#include "engine/intersectors/opaque.h"
#include "engine/queries/queries.h"
#include "engine/scene/snapshot.h"
#include "tests/conformance/scenes.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <bit>
#include <cstring>
#include <limits>
#include <vector>

using namespace raynest;

#ifdef RAYNEST_TEST_NODES_TOGETHER
static_assert(nodes_together == RAYNEST_TEST_NODES_TOGETHER);
#endif

namespace {

// Visits children in the order of the ray's octant. A waiting child is skipped once the best hit is
// nearer. A node is tested together with the nodes that wait next to it.
class ScalarWalk {
public:
    ScalarWalk(const SceneView& scene, Counters& counters) : scene_(scene), counters_(counters) {}

    void object(RayView& ray, std::uint32_t index) {
        ray.object = &scene_.objects[index];
        if (ray.object->root == child_empty) return;
        std::vector<Waiting> waiting{{-std::numeric_limits<float>::infinity(), ray.object->root}};
        while (!waiting.empty()) {
            const Waiting next = take(waiting);
            if (next.near > ray.tmax) continue;
            if (is_leaf(next.child)) {
                leaf(ray, *ray.object, next.child);
                continue;
            }
            std::vector<std::uint32_t> nodes{next.child};
            while (nodes.size() < nodes_together && !waiting.empty() &&
                   !is_leaf(waiting.back().child) && waiting.back().near <= ray.tmax)
                nodes.push_back(take(waiting).child);
            most_together = std::max(most_together, nodes.size());
            for (auto node = nodes.rbegin(); node != nodes.rend(); ++node)
                enter_children(ray, scene_.nodes[ray.object->first_node + *node], waiting);
        }
    }
    ClosestHit query;
    std::size_t most_together = 0;  ///< most nodes tested at once

private:
    struct Waiting {
        float near;
        std::uint32_t child;
    };

    static Waiting take(std::vector<Waiting>& waiting) {
        const Waiting last = waiting.back();
        waiting.pop_back();
        return last;
    }

    void leaf(RayView& ray, const ObjectRecord& object, std::uint32_t word) {
        if (kind_of(word) == ChildKind::instance) {
            const InstanceRecord& instance =
                scene_.instances[object.first_instance + leaf_instance(word)];
            if ((instance.mask & ray.mask) == 0) return;
            ++counters_.instances;
            const std::uint32_t hits = counters_.prim_hits;
            RayView inner = enter(ray, scene_, instance);
            this->object(inner, instance.object);
            ray.tmax = inner.tmax;
            counters_.instance_misses += counters_.prim_hits == hits ? 1 : 0;
            return;
        }
        ++counters_.leaves;
        if (kind_of(word) == ChildKind::records) {
            visit_record_type(scene_, object, leaf_first(word), leaf_count(word),
                              [&](const auto& record) {
                                  ++counters_.prims;
                                  count_hits(ray, record);
                                  Opaque opaque;
                                  visit(ray, record, opaque, query);
                                  return false;
                              });
            return;
        }
        for (std::uint32_t b = 0; b < leaf_count(word); ++b) {
            const TriangleBlock& block = scene_.blocks[object.first_block + leaf_first(word) + b];
            for (int lane = 0; lane < 8; ++lane) {
                if (block.triangle[lane] == no_id) continue;
                ++counters_.prims;
                count_hits(ray, TriangleRef(block, lane));
                Opaque opaque;
                visit(ray, TriangleRef(block, lane), opaque, query);
            }
        }
    }

    void count_hits(const RayView& ray, const auto& primitive) {
        counters_.prim_hits +=
            static_cast<std::uint32_t>(std::popcount(intersect(ray, primitive).mask));
    }

    /// Pushes the farthest child first, so that the nearest is on top.
    void enter_children(const RayView& ray, const Node& node, std::vector<Waiting>& waiting) {
        ++counters_.nodes;
        for (int i = 0; i < 8; ++i) {
            const std::uint32_t slot = node.order[i] >> (3 * (octant(ray) ^ 7U)) & 7U;
            if (node.child[slot] == child_empty) continue;
            ++counters_.boxes;
            const auto span = intersect(ray, Boxes8{&node}.box_of(static_cast<int>(slot)));
            if (span.mask != 0) waiting.push_back({span.near.lane[0], node.child[slot]});
        }
    }

    static std::uint32_t octant(const RayView& ray) {
        std::uint32_t bits = 0;
        for (int axis = 0; axis < 3; ++axis) bits |= std::uint32_t{ray.direction[axis] < 0} << axis;
        return bits;
    }

    const SceneView& scene_;
    Counters& counters_;
};

/// Accepts only the children at even places of a node.
struct EveryOtherBox {
    auto operator()(const auto& ray, const BoxLike auto& boxes) {
        auto spans = intersect(ray, boxes);
        spans.mask &= 0x55U;
        return spans;
    }
};

/// Refuses triangles of odd numbers, asked in the usual way.
struct Odd {
    static bool keeps(const Surface& surface) { return surface.prim % 2 == 0; }
    auto operator()(const auto& ray, const TriangleLike auto& triangle) {
        auto hits = intersect(ray, triangle);
        hits.keep_if(keeps);
        return hits;
    }
};
/// The same, with an overload for blocks, which a type made from blocks must not miss.
struct OddByName {
    int blocks = 0;
    auto operator()(const auto& ray, const TriangleLike auto& triangle) {
        auto hits = intersect(ray, triangle);
        hits.mask = 0;
        return hits;
    }
    auto operator()(const auto& ray, const Triangles8& block) {
        ++blocks;
        return Odd()(ray, block);
    }
};
/// The same, but what it asks is about a ray that is longer than the one that it is given.
struct OddOfAnother {
    auto operator()(const auto& ray, const TriangleLike auto& triangle) {
        auto longer = ray;
        longer.tmax = search_end(*ray.world);
        auto hits = intersect(longer, triangle);
        hits.keep_if(
            [&](const Surface& surface) { return surface.t <= ray.tmax && Odd::keeps(surface); });
        return hits;
    }
};

/// Returns the closest hit of a ray under an intersector.
template <class Isect>
HitRecord closest(const Ray& ray, const SceneView& view, Isect& isect) {
    RayView start = outermost_view(ray, &view, 0, 0xFFFFFFFFU, 0);
    start.object = &view.objects[view.root];
    ClosestHit query;
    BoxRay boxed(start);
    traverse(boxed, Bvh{&view, view.root}, isect, query);
    return query.best;
}

}  // namespace

TEST_CASE("an intersector with boxes of its own answers alike, counted or not") {
    conformance::Random random(10);
    const auto scene = Snapshot::build(conformance::nested_scene(3, 4));
    REQUIRE(scene.has_value());
    const SceneView& view = (*scene)->view();
    int different = 0;
    int hidden = 0;
    for (const Ray& ray : conformance::random_rays(2000, 6, random)) {
        Opaque opaque;
        EveryOtherBox other;
        Counters counters;
        Counting<EveryOtherBox> counting{other, &counters};
        const float plain = closest(ray, view, other).t;
        different += closest(ray, view, counting).t != plain;
        hidden += closest(ray, view, opaque).t != plain;
    }
    CHECK(different == 0);
    CHECK(hidden > 100);
}

TEST_CASE("refused and accepted candidates are counted however an intersector asks for them") {
    conformance::Random random(11);
    const auto scene = Snapshot::build(conformance::sheet_scene(20000, 2, 4));
    REQUIRE(scene.has_value());
    const SceneView& view = (*scene)->view();
    int different = 0;
    std::uint64_t rejects = 0;
    std::uint64_t accepted = 0;
    OddByName named;
    for (const Ray& ray : conformance::random_rays(2000, 6, random)) {
        Odd odd;
        OddOfAnother another;
        Counters counters[3];
        Counting<Odd> counting{odd, &counters[0]};
        Counting<OddByName> by_name{named, &counters[1]};
        Counting<OddOfAnother> of_another{another, &counters[2]};
        const HitRecord hit = closest(ray, view, counting);
        for (const HitRecord& other : {closest(ray, view, by_name), closest(ray, view, of_another)})
            different += std::memcmp(&hit, &other, sizeof hit) != 0;
        for (const Counters& other : counters)
            different += std::memcmp(&counters[0], &other, sizeof other) != 0;
        different += hit.hit != 0 && hit.triangle % 2 != 0;
        rejects += counters[0].rejects;
        accepted += counters[0].prim_hits - counters[0].rejects;
    }
    CHECK(different == 0);
    CHECK(named.blocks > 0);
    CHECK(rejects > 40);
    CHECK(accepted > 40);
}

TEST_CASE("node, box, leaf, primitive and instance counts equal those of a scalar walk") {
    conformance::Random random(9);
    // The trees of the nested scenes are so small that hardly three nodes wait.
    std::size_t most_together = 0;
    for (const SceneDescription& description :
         {conformance::nested_scene(1, 4), conformance::nested_scene(2, 4),
          conformance::nested_scene(3, 4), conformance::sheet_scene(20000, 2, 4)}) {
        const auto scene = Snapshot::build(description);
        REQUIRE(scene.has_value());
        const SceneView& view = (*scene)->view();
        auto rays = conformance::random_rays(2000, 6, random);
        const auto edges = conformance::edge_rays(description, 500, 6, random);
        rays.insert(rays.end(), edges.begin(), edges.end());

        std::uint64_t boxes = 0;
        std::uint64_t instances = 0;
        std::uint64_t misses = 0;
        int different = 0;
        for (const Ray& ray : rays) {
            Counters counted;
            Opaque opaque;
            Counting<Opaque> counting{opaque, &counted};
            RayView start = outermost_view(ray, &view, 0, 0xFFFFFFFFU, 0);
            start.object = &view.objects[view.root];
            ClosestHit query;
            BoxRay boxed(start);
            traverse(boxed, Bvh{&view, view.root}, counting, query);

            std::vector<Counters> levels(view.objects[view.root].levels);
            Counting<Opaque, true> by_level{opaque, levels.data(),
                                            static_cast<std::uint32_t>(levels.size())};
            ClosestHit again;
            BoxRay twice(start);
            traverse(twice, Bvh{&view, view.root}, by_level, again);
            Counters sum;
            for (const Counters& level : levels) {
#define RAYNEST_COUNTER(name, title) sum.name += level.name;
#define RAYNEST_SUM(...)
#include "engine/geometry/counters.def"
            }
            different += std::memcmp(&sum, &counted, sizeof sum) != 0;
            // Each entered instance opens a tree one level below.
            for (std::size_t level = 1; level < levels.size(); ++level)
                different += levels[level].nodes != 0 && levels[level - 1].instances == 0;
            different += levels[0].nodes == 0;

            Counters expected;
            ScalarWalk walk(view, expected);
            RayView scalar = start;
            walk.object(scalar, view.root);
            different += counted.nodes != expected.nodes || counted.boxes != expected.boxes ||
                         counted.leaves != expected.leaves || counted.prims != expected.prims ||
                         counted.instances != expected.instances ||
                         counted.instance_misses != expected.instance_misses ||
                         query.best.t != walk.query.best.t;
            most_together = std::max(most_together, walk.most_together);
            boxes += counted.boxes;
            instances += counted.instances;
            misses += counted.instance_misses;
        }
        CHECK(different == 0);
        CHECK(boxes > rays.size());
        CHECK((instances > 0) == (description.objects.size() > 1));
        CHECK((misses > 0) == (instances > 0));
        CHECK((misses < instances) == (instances > 0));
    }
    CHECK(most_together == nodes_together);
}
