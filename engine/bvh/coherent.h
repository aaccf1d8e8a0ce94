// The coherent traversal: 64 rays that look in nearly the same direction walk a tree together.
//
// A node is tested once for all of them, with the interval of their origins and reciprocal
// directions (Reshetov, Soupikov, Hurley, "Multi-level ray tracing algorithm", 2005; the width of
// 64 is the win: packets of 16 only equal Embree's). In a leaf sixteen rays meet one triangle at a
// time. Rays that turn out not to be coherent go on one by one: those with other direction signs
// than their neighbours, those that meet a leaf nearly alone, and all of an intersector that looks
// at primitives itself, which is asked ray by ray as by the latency traversal.
//
// The interval contains what each ray's own box rule (geometry/slabs.h) answers, so no hit is lost
// and the answers are those of the other traversals, bit for bit.
#pragma once

#include "engine/bvh/packet.h"
#include "engine/bvh/tree_arrays.h"
#include "engine/geometry/coherence.h"

#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <new>
#include <utility>

namespace raynest {

/// Fewer rays than this are traced one by one.
inline constexpr int packet_rays_min = 8;

/// Traces up to 64 rays of a feed; `Isect` must not decide about boxes, which are not asked ray by
/// ray here.
template <class Isect, class Query>
class Coherent {
public:
    explicit Coherent(Isect& isect) : isect_(isect) {}

    template <class Feed>
    void trace(const Bvh& root, std::uint32_t count, const Feed& feed) {
        cancellation_ = feed.cancellation;
        PacketLevel level;
        RaySet rays = 0;
        for (std::uint32_t i = 0; i < packet_rays; ++i) {
            // Any valid ray fills the other lanes; it is never looked at.
            RayView view{Vec3(0), Vec3(1), 0, 0, nullptr, nullptr, nullptr, 0, i, mask_, flags_};
            if (i < count && feed.begin(i, view)) {
                rays |= RaySet{1} << i;
                queries_[i] = feed.query(i);
                mask_ = view.mask;
                flags_ = view.flags;
            }
            world_[i] = view.world;
            for (int axis = 0; axis < 3; ++axis) {
                level.origin[axis].of[i] = view.origin[axis];
                level.direction[axis].of[i] = view.direction[axis];
            }
            range_.tmin.of[i] = view.tmin;
            range_.tmax.of[i] = view.tmax;
        }
        if (rays == 0) return;
        live_ = rays;
        visit_level({root.scene, &root.record(), 0}, level, rays);
        for (RaySet rest = rays; rest != 0; rest &= rest - 1) {
            const auto i = static_cast<std::uint32_t>(std::countr_zero(rest));
            feed.end(i, queries_[i]);
        }
    }

private:
    using F8 = Lanes<8>;
    // A primitive that the intersector looks at is tested ray by ray.
    static constexpr bool asks_primitives = Overrides<Isect, BoxRay, Triangles8>;

    struct Place {
        const SceneView* scene;
        const ObjectRecord* object;
        std::uint64_t path;
    };

    struct Entry {
        const Node* node;
        std::uint32_t slot;  ///< of `node`; its child is what the entry stands for
        float near;
    };

    /// What the rays of a set have in common, widened so that it contains each one's own box test.
    ///
    /// Per axis, near = min over rays of (plane - origin) / direction. The box rule of one ray may
    /// be lower than the exact value by twice its error term and a few roundings; three times the
    /// largest term and 2^-20 of the slope contain all of it.
    struct Bounds {
        float near_origin[3], far_origin[3];
        float least_slope[3], most_slope[3];
        std::uint32_t near_row[3];
        float tmin;

        Bounds(const PacketLevel& level, const PacketRange& range, float origin_error, RaySet rays,
               std::uint32_t octant) {
            constexpr float slack = 0x1p-20F;
            float extent = 0;
            float lower[3], upper[3];
            for (std::uint32_t axis = 0; axis < 3; ++axis) {
                lower[axis] = least_of(level.origin[axis], rays);
                upper[axis] = most_of(level.origin[axis], rays);
                least_slope[axis] = least_of(level.reciprocal[axis], rays);
                most_slope[axis] = most_of(level.reciprocal[axis], rays);
                extent = std::max({extent, std::abs(lower[axis]), std::abs(upper[axis])});
            }
            tmin = least_of(range.tmin, rays);
            extent *= 3 * origin_error * box_origin_error;
            for (int axis = 0; axis < 3; ++axis) {
                near_row[axis] = octant >> axis & 1U;
                const bool backwards = near_row[axis] != 0;
                near_origin[axis] = backwards ? lower[axis] - extent : upper[axis] + extent;
                far_origin[axis] = backwards ? upper[axis] + extent : lower[axis] - extent;
                least_slope[axis] *= backwards ? 1 + slack : 1 - slack;
                most_slope[axis] *= backwards ? 1 - slack : 1 + slack;
            }
        }
    };

    RAYNEST_INLINE static std::uint32_t enter_boxes(const Bounds& bounds, const Node& node,
                                                    float tmax, F8& near_out) {
        const float(*rows)[3][8] = &node.lower;
        const auto plane = [&](std::uint32_t row, int axis)
                               RAYNEST_INLINE_LAMBDA { return F8::load(rows[row][axis]); };
        return enter(bounds, plane, tmax, near_out) & node.valid();
    }

    /// Triangles of a block whose own boxes the set may enter: those of a leaf lie side by side,
    /// and a packet is often smaller than they are (measured: 1.25 times on
    /// alpha cards).
    RAYNEST_INLINE static std::uint32_t enter_triangles(const Bounds& bounds,
                                                        const TriangleBlock& block, float tmax) {
        const auto plane = [&](std::uint32_t row, int axis) RAYNEST_INLINE_LAMBDA {
            const F8 a = F8::load(block.vertex[0][axis]);
            const F8 b = F8::load(block.vertex[1][axis]);
            const F8 c = F8::load(block.vertex[2][axis]);
            return row == 0 ? minimum(a, minimum(b, c)) : maximum(a, maximum(b, c));
        };
        F8 near;
        return enter(bounds, plane, tmax, near) & Triangles8{&block, false}.valid();
    }

    /// Boxes whose interval with the whole set is not empty; `plane(row, axis)` are their lower
    /// (row 0) or upper sides.
    template <class Plane>
    RAYNEST_INLINE static std::uint32_t enter(const Bounds& bounds, const Plane& plane, float tmax,
                                              F8& near_out) {
        const auto least = [&](int axis) RAYNEST_INLINE_LAMBDA {
            const F8 a = plane(bounds.near_row[axis], axis) - F8::splat(bounds.near_origin[axis]);
            return minimum(a * F8::splat(bounds.least_slope[axis]),
                           a * F8::splat(bounds.most_slope[axis]));
        };
        const auto most = [&](int axis) RAYNEST_INLINE_LAMBDA {
            const F8 a =
                plane(bounds.near_row[axis] ^ 1U, axis) - F8::splat(bounds.far_origin[axis]);
            return maximum(a * F8::splat(bounds.least_slope[axis]),
                           a * F8::splat(bounds.most_slope[axis]));
        };
        near_out = maximum(maximum(least(0), least(1)), maximum(least(2), F8::splat(bounds.tmin)));
        const F8 far = minimum(minimum(most(0), most(1)), minimum(most(2), F8::splat(tmax)));
        return less_equal(near_out, far);
    }

    /// Rays of a group that enter one child's box, by each ray's own rule.
    RAYNEST_INLINE std::uint32_t enter_box(const PacketLevel& level, const Bounds& bounds,
                                           const Node& node, std::uint32_t slot,
                                           std::uint32_t g) const {
        const RayGroup::Slabs slabs{level, g};
        const float(*rows)[3][8] = &node.lower;
        const auto near = [&](int axis) RAYNEST_INLINE_LAMBDA {
            return slabs.near_plane(axis,
                                    PacketLanes::splat(rows[bounds.near_row[axis]][axis][slot]));
        };
        const auto far = [&](int axis) RAYNEST_INLINE_LAMBDA {
            return slabs.far_plane(
                axis, PacketLanes::splat(rows[bounds.near_row[axis] ^ 1U][axis][slot]));
        };
        const auto span =
            Interval<packet_lanes>::of({near(0), near(1), near(2)}, {far(0), far(1), far(2)});
        return less_equal(maximum(span.near, range_.tmin.group(g)),
                          minimum(span.far, range_.tmax.group(g)));
    }

    /// Rays of `rays` that enter the child, by each ray's own rule.
    RaySet enter_child(const PacketLevel& level, const Bounds& bounds, const Entry& entry,
                       RaySet rays) const {
        RaySet inside = 0;
        for (std::uint32_t g = 0; g < packet_groups; ++g) {
            if ((rays >> (packet_lanes * g) & group_bits) == 0) continue;
            inside |= RaySet{enter_box(level, bounds, *entry.node, entry.slot, g)}
                      << (packet_lanes * g);
        }
        return inside & rays;
    }

    /// The largest distance that still matters to a ray of the set.
    [[nodiscard]] float farthest(RaySet rays) const { return most_of(range_.tmax, rays); }

    /// A ray by itself, in the space of the level.
    [[nodiscard]] RayView single(const Place& place, const PacketLevel& level,
                                 std::uint32_t i) const {
        const auto at = [i](const PacketRow(&v)[3]) {
            return Vec3(v[0].of[i], v[1].of[i], v[2].of[i]);
        };
        return {at(level.origin),
                at(level.direction),
                range_.tmin.of[i],
                range_.tmax.of[i],
                world_[i],
                place.scene,
                place.object,
                place.path,
                i,
                mask_,
                flags_};
    }

    /// visit(ray, thing) for every ray of the set, one by one.
    template <class Visit>
    void one_by_one(const Place& place, const PacketLevel& level, RaySet rays, Visit&& visit_one) {
        for (; rays != 0; rays &= rays - 1) {
            const auto i = static_cast<std::uint32_t>(std::countr_zero(rays));
            BoxRay ray(single(place, level, i));
            if (visit_one(ray, queries_[i])) live_ &= ~(RaySet{1} << i);
            range_.tmax.of[i] = ray.tmax;
        }
    }

    /// Everything below one object for the rays of the set: by octants, or one by one.
    void visit_level(const Place& place, PacketLevel& level, RaySet rays) {
        level.prepare(place.object->origin_error);
        RaySet alone = rays & ~level.finite;
        RaySet rest = rays & level.finite;
        while (rest != 0) {
            const auto first = static_cast<std::uint32_t>(std::countr_zero(rest));
            RaySet alike = rest;
            std::uint32_t octant = 0;
            for (std::uint32_t axis = 0; axis < 3; ++axis) {
                const bool backwards = (level.backwards[axis] >> first & 1U) != 0;
                octant |= static_cast<std::uint32_t>(backwards) << axis;
                alike &= backwards ? level.backwards[axis] : ~level.backwards[axis];
            }
            rest &= ~alike;
            if (std::popcount(alike) < packet_rays_min ||
                !is_coherent(*place.object, level, alike)) {
                alone |= alike;
            } else {
                walk(place, level, alike, octant);
            }
        }
        const Bvh bvh{place.scene, static_cast<std::uint32_t>(place.object - place.scene->objects)};
        one_by_one(place, level, alone & live_, [&](BoxRay& ray, Query& query) {
            return is_cancelled(cancellation_, work_in(*place.object)) ||
                   visit_tree(ray, bvh, isect_, query);
        });
    }

    /// Whether an interval around the rays of a set is worth a walk: they look the same way from
    /// the same place (geometry/coherence.h).
    static bool is_coherent(const ObjectRecord& object, const PacketLevel& level, RaySet rays) {
        const Vec3 size = object.bounds.size();
        float turn = 0;
        float shift = 0;
        const auto first = std::countr_zero(rays);
        float main = 0;
        for (int axis = 0; axis < 3; ++axis) {
            const PacketRow& d = level.direction[axis];
            const PacketRow& o = level.origin[axis];
            turn = std::max(turn, most_of(d, rays) - least_of(d, rays));
            shift = std::max(shift, most_of(o, rays) - least_of(o, rays));
            main = std::max(main, std::abs(d.of[first]));
        }
        return turn <= coherent_turn * main && shift <= coherent_shift * largest_component(size);
    }

    [[gnu::noinline]] void walk(const Place& place, const PacketLevel& level, RaySet rays,
                                std::uint32_t octant) {
        const ObjectRecord& object = *place.object;
        const TreeArrays arrays(*place.scene, object);
        const Bounds bounds(level, range_, object.origin_error, rays, octant);
        if (object.root == child_empty) return;
        if (is_leaf(object.root)) {
            visit_leaf(place, level, bounds, object.root, rays & live_);
            return;
        }

        Entry stack[7 * tree_height_max + 8];
        Entry* top = stack;
        float tmax = farthest(rays & live_);
        const Node* node = &arrays.node(object.root);
        for (;;) {
            F8 spans;
            const std::uint32_t mask = enter_boxes(bounds, *node, tmax, spans);
            alignas(32) float near[8];
            spans.store(near);
            Entry* const base = top;
            for (std::uint32_t rest = mask; rest != 0; rest &= rest - 1) {
                const auto slot = static_cast<std::uint32_t>(std::countr_zero(rest));
                Entry* at = top++;
                for (; at != base && at[-1].near <= near[slot]; --at) *at = at[-1];
                *at = {node, slot, near[slot]};
                arrays.prefetch(node->child[slot]);
            }

            // Down to the next inner node; leaves on the way.
            for (;;) {
                if (top == stack) return;
                --top;
                if (top->near > tmax) continue;
                const std::uint32_t child = top->node->child[top->slot];
                if (!is_leaf(child)) {
                    node = &arrays.node(child);
                    break;
                }
                const RaySet inside = enter_child(level, bounds, *top, rays & live_);
                if (inside == 0) continue;
                visit_leaf(place, level, bounds, child, inside);
                if ((rays & live_) == 0) return;
                tmax = farthest(rays & live_);
            }
        }
    }

    void visit_leaf(const Place& place, const PacketLevel& level, const Bounds& bounds,
                    std::uint32_t leaf, RaySet rays) {
        if (is_cancelled(cancellation_, packet_rays)) {
            live_ = 0;
            return;
        }
        const SceneView& scene = *place.scene;
        const ObjectRecord& object = *place.object;
        switch (kind_of(leaf)) {
            case ChildKind::triangles: {
                const TriangleBlock* blocks = scene.blocks + object.first_block + leaf_first(leaf);
                for (std::uint32_t b = 0; b < leaf_count(leaf); ++b) {
                    visit_block(place, level, bounds, Triangles8{blocks + b, b == 0}, rays & live_);
                }
                break;
            }
            case ChildKind::records:
                one_by_one(place, level, rays, [&](BoxRay& ray, Query& query) {
                    return visit_record_type(
                        scene, object, leaf_first(leaf), leaf_count(leaf),
                        [&](const auto& record) { return visit(ray, record, isect_, query); });
                });
                break;
            case ChildKind::instance:
                visit_instance(place, level,
                               Instance{&scene, object.first_instance + leaf_instance(leaf)}, rays);
                break;
        }
    }

    void visit_block(const Place& place, const PacketLevel& level, const Bounds& bounds,
                     const Triangles8& block, RaySet rays) {
        RaySet alone = rays;
        if (!asks_primitives && flags_ == 0) {
            alone = 0;
            const std::uint32_t triangles = enter_triangles(bounds, *block.block, farthest(rays));
            if (triangles == 0) return;
            for (std::uint32_t g = 0; g < packet_groups; ++g) {
                const RaySet members = rays & (RaySet{group_bits} << (packet_lanes * g));
                if (members == 0) continue;
                std::uint32_t z = 0;
                while (z < 3 && (members & ~level.largest[z]) != 0) ++z;
                // One by one where that is fewer tests, or hardly more: a ray meets all triangles
                // of a block at once, a group one of them, and looks at each of its hits (measured
                // on small triangles: 1.15 times, and 1.05 for the half; twice as many cost 15 % on
                // large ones).
                if (z == 3 || 2 * std::popcount(members) <= 3 * std::popcount(triangles)) {
                    alone |= members;
                } else {
                    visit_block_by_group(place, level, *block.block, triangles,
                                         members >> (packet_lanes * g), g, z);
                }
            }
        }
        for (; alone != 0; alone &= alone - 1) {
            const auto i = static_cast<std::uint32_t>(std::countr_zero(alone));
            PacketRay ray(single(place, level, i), level, i);
            if (visit(ray, block, isect_, queries_[i])) live_ &= ~(RaySet{1} << i);
            range_.tmax.of[i] = ray.tmax;
        }
    }

    /// Sixteen rays against one triangle after the other.
    void visit_block_by_group(const Place& place, const PacketLevel& level,
                              const TriangleBlock& block, std::uint32_t triangles, RaySet members,
                              std::uint32_t g, std::uint32_t z) {
        RayGroup group(level, range_, g, z);
        const std::uint32_t first = packet_lanes * g;
        for (; triangles != 0; triangles &= triangles - 1) {
            const auto lane = static_cast<std::uint32_t>(std::countr_zero(triangles));
            auto hits = intersect(group, SharedTriangle{&block, lane});
            hits.mask &= static_cast<std::uint32_t>(members);
            if (hits.mask == 0) continue;
            RayView at{};
            at.scene = place.scene;
            at.object = place.object;
            at.path = place.path;
            for_each_record(at, hits, [&](int ray, const HitRecord& record) {
                const std::uint32_t i = first + static_cast<std::uint32_t>(ray);
                if (queries_[i].add(record, range_.tmax.of[i])) {
                    live_ &= ~(RaySet{1} << i);
                    members &= ~(RaySet{1} << ray);
                }
            });
            group.tmax = range_.tmax.group(g);
        }
    }

    void visit_instance(const Place& place, const PacketLevel& level, const Instance& instance,
                        RaySet rays) {
        const InstanceRecord& record = instance.record();
        if ((record.mask & mask_) == 0) return;
        if (std::popcount(rays) < packet_rays_min || Overrides<Isect, BoxRay, Instance>) {
            one_by_one(place, level, rays, [&](BoxRay& ray, Query& query) {
                return visit(ray, instance, isect_, query);
            });
            return;
        }
        PacketLevel inner;
        for (std::uint32_t g = 0; g < packet_groups; ++g) {
            const auto& m = record.to_object.m;
            const auto F = [](float value) { return PacketLanes::splat(value); };
            const PacketLanes o[3] = {level.origin[0].group(g), level.origin[1].group(g),
                                      level.origin[2].group(g)};
            const PacketLanes d[3] = {level.direction[0].group(g), level.direction[1].group(g),
                                      level.direction[2].group(g)};
            for (std::size_t row = 0; row < 3; ++row) {  // as Transform::point and ::direction
                const float* a = &m[4 * row];
                inner.origin[row].set_group(
                    g, fused(F(a[0]), o[0], fused(F(a[1]), o[1], fused(F(a[2]), o[2], F(a[3])))));
                inner.direction[row].set_group(
                    g, fused(F(a[0]), d[0], fused(F(a[1]), d[1], F(a[2]) * d[2])));
            }
        }
        visit_level(
            {place.scene, &place.scene->objects[record.object], place.path + record.path_base},
            inner, rays);
    }

    Isect& isect_;
    PacketRange range_;
    RaySet live_ = 0;         ///< rays whose query is not answered yet
    std::uint32_t mask_ = 0;  ///< of the call, as in RayView
    std::uint32_t flags_ = 0;
    Cancellation* cancellation_ = nullptr;
    const Ray* world_[packet_rays];
    Query queries_[packet_rays];
};

}  // namespace raynest
