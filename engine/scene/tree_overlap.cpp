#include "engine/scene/tree_overlap.h"

#include "engine/bvh/build_cut.h"
#include "engine/bvh/node.h"
#include "engine/geometry/triangle.h"
#include "engine/math/random.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <iterator>
#include <limits>

namespace raynest {
namespace {

/// Points of one object, at most; each has as many where the scene has few objects, so that the
/// estimate of a small one scatters little.
constexpr std::uint32_t points_max = 512;
/// Points of one object, at least.
constexpr std::uint32_t points_min = 8;
/// Points of all objects, about, where all are small.
constexpr std::uint32_t points_in_all = 1 << 18;
/// Nodes and leaves that are looked at in all.
constexpr std::uint64_t visits_max = 1 << 24;
/// Blocks of one object whose triangles are looked at, about; the others are like them.
constexpr std::uint32_t blocks_max = 1 << 16;

/// A point of a surface, and what holds that surface.
struct Point {
    Vec3 at;
    std::uint32_t leaf;   ///< leaf in the object's tree
    std::uint32_t way;    ///< where the nodes above the leaf begin in Points::ways
    std::uint32_t below;  ///< if the leaf is an instance: the point of its object
};

/// Points that are spread evenly over the area of an object, instances included.
struct Points {
    double area = 0;
    std::vector<Point> all;
    std::vector<std::uint32_t> ways;  ///< nodes from the leaf up to the root, no_id behind it
};

Vec3 corner(const TriangleBlock& block, std::uint32_t lane, std::size_t k) {
    return {block.vertex[k][0][lane], block.vertex[k][1][lane], block.vertex[k][2][lane]};
}

double area_of(const TriangleBlock& block, std::uint32_t lane) {
    const Vec3 a = corner(block, lane, 0);
    const Vec3 normal = glm::cross(corner(block, lane, 1) - a, corner(block, lane, 2) - a);
    const double area = 0.5 * static_cast<double>(glm::length(normal));
    return std::isfinite(area) ? area : 0;
}

/// By how much a placement enlarges areas, on average.
double area_scale(const Transform& t) {
    const auto m = [&](std::size_t row, std::size_t column) {
        return static_cast<double>(t.m[4 * row + column]);
    };
    const double volume = m(0, 0) * (m(1, 1) * m(2, 2) - m(1, 2) * m(2, 1)) -
                          m(0, 1) * (m(1, 0) * m(2, 2) - m(1, 2) * m(2, 0)) +
                          m(0, 2) * (m(1, 0) * m(2, 1) - m(1, 1) * m(2, 0));
    return std::pow(std::abs(volume), 2.0 / 3);
}

bool contains(const Node& node, std::uint32_t slot, const Vec3& p) {
    for (int axis = 0; axis < 3; ++axis)
        if (!(node.lower[axis][slot] <= p[axis] && p[axis] <= node.upper[axis][slot])) return false;
    return true;
}

class OverlapMeasurer {
public:
    explicit OverlapMeasurer(const SceneView& scene)
        : scene_(scene),
          points_each_(std::clamp(points_in_all / std::max(scene.object_count, 1U), points_min,
                                  points_max)) {}

    std::vector<double> measure() {
        std::vector<double> overlaps;
        for (std::uint32_t i = 0; i < scene_.object_count; ++i) {
            add_points();
            overlaps.push_back(mean_overlap(i));
        }
        return overlaps;
    }

    double measure_root() {
        while (points_.size() <= scene_.root) add_points();
        return mean_overlap(scene_.root);
    }

private:
    /// Draws the points of the next object; children come first.
    void add_points() {
        // The same numbers for each object: equal ones have equal points.
        random_ = Random(1);
        points_.push_back(points_of(scene_.objects[points_.size()]));
    }

    double mean_overlap(std::uint32_t object) {
        const Points& points = points_[object];
        double sum = 0;
        for (const Point& point : points.all) sum += overlap_at(object, point.at, &point);
        if (points.all.empty() || visits_ > visits_max)
            return std::numeric_limits<double>::quiet_NaN();
        return sum / static_cast<double>(points.all.size());
    }

    [[nodiscard]] const InstanceRecord& instance(const ObjectRecord& object,
                                                 std::uint32_t leaf) const {
        return scene_.instances[object.first_instance + leaf_instance(leaf)];
    }

    /// Calls visit(holder, leaf, area, block, lane) for all that has an area: triangles, and
    /// instances without a block. The holder of a root is no_id.
    template <class Visit>
    void for_each_area(const ObjectRecord& object, Visit&& visit) const {
        const std::uint32_t each = object.block_count / blocks_max + 1;
        const auto visit_leaf = [&](std::uint32_t holder, std::uint32_t leaf) {
            if (leaf == child_empty) return;
            if (kind_of(leaf) == ChildKind::instance) {
                const std::uint32_t at = object.first_instance + leaf_instance(leaf);
                const Points& inner = points_[scene_.instances[at].object];
                const double area =
                    inner.all.empty()
                        ? 0
                        : inner.area * area_scale(scene_.instance_infos[at].to_parent);
                visit(holder, leaf, std::isfinite(area) ? area : 0, nullptr, 0);
            } else if (kind_of(leaf) == ChildKind::triangles) {
                const TriangleBlock* const blocks = scene_.blocks + object.first_block;
                const std::uint32_t end = leaf_first(leaf) + leaf_count(leaf);
                for (std::uint32_t b = leaf_first(leaf); b < end; ++b) {
                    if (b % each != 0) continue;
                    for (std::uint32_t lane = 0; lane < 8; ++lane)
                        visit(holder, leaf, each * area_of(blocks[b], lane), blocks + b, lane);
                }
            }
        };
        if (object.node_count == 0) visit_leaf(no_id, object.root);
        for (std::uint32_t i = 0; i < object.node_count; ++i)
            for (const std::uint32_t child : scene_.nodes[object.first_node + i].child)
                if (is_leaf(child)) visit_leaf(i, child);
    }

    [[nodiscard]] std::vector<std::uint32_t> parents_of(const ObjectRecord& object) const {
        std::vector<std::uint32_t> parents(object.node_count, no_id);
        for (std::uint32_t i = 0; i < object.node_count; ++i)
            for (const std::uint32_t child : scene_.nodes[object.first_node + i].child)
                if (!is_leaf(child)) parents[child] = i;
        return parents;
    }

    Points points_of(const ObjectRecord& object) {
        Points points;
        for_each_area(object, [&](auto, auto, double area, auto, auto) { points.area += area; });
        if (!(points.area > 0)) return points;
        const std::vector<std::uint32_t> parents = parents_of(object);
        const std::uint32_t count = std::clamp(object.node_count, points_each_, points_max);
        const double step = points.area / count;
        double next = 0.5 * step;
        double passed = 0;
        for_each_area(object, [&](std::uint32_t holder, std::uint32_t leaf, double area,
                                  const TriangleBlock* block, std::uint32_t lane) {
            for (passed += area; next < passed && points.all.size() < count; next += step) {
                Point point = block != nullptr ? on_triangle(*block, lane) : inside(object, leaf);
                point.leaf = leaf;
                point.way = static_cast<std::uint32_t>(points.ways.size());
                for (std::uint32_t node = holder; node != no_id; node = parents[node])
                    points.ways.push_back(node);
                points.ways.push_back(no_id);
                points.all.push_back(point);
            }
        });
        return points;
    }
    Point on_triangle(const TriangleBlock& block, std::uint32_t lane) {
        float u = random_.uniform();
        float v = random_.uniform();
        if (u + v > 1) {
            u = 1 - u;
            v = 1 - v;
        }
        const Vec3 a = corner(block, lane, 0);
        return {a + u * (corner(block, lane, 1) - a) + v * (corner(block, lane, 2) - a), 0, 0, 0};
    }
    Point inside(const ObjectRecord& object, std::uint32_t leaf) {
        const std::uint32_t at = object.first_instance + leaf_instance(leaf);
        const Points& inner = points_[scene_.instances[at].object];
        const auto below = random_.below(static_cast<std::uint32_t>(inner.all.size()));
        return {scene_.instance_infos[at].to_parent.point(inner.all[below].at), 0, 0, below};
    }

    /// Returns the cost of what holds a point of space, but not the surface of `own`: that lies in
    /// the object, on the way that it names. Null: it lies elsewhere.
    double overlap_at(std::uint32_t object, const Vec3& at, const Point* own) {
        const std::uint32_t* way = nullptr;
        if (own != nullptr) way = points_[object].ways.data() + own->way;
        return overlap_below(scene_.objects[object], scene_.objects[object].root, at, own, way);
    }

    static bool holds(std::uint32_t child, const Point* own, const std::uint32_t* way) {
        if (own == nullptr) return false;
        if (is_leaf(child)) return child == own->leaf;
        while (*way != no_id && *way != child) ++way;
        return *way == child;
    }

    double overlap_below(const ObjectRecord& object, std::uint32_t child, const Vec3& at,
                         const Point* own, const std::uint32_t* way) {
        if (child == child_empty || ++visits_ > visits_max) return 0;
        const bool holds_own = holds(child, own, way);
        if (is_leaf(child)) return overlap_of_leaf(object, child, at, holds_own ? own : nullptr);
        double sum = holds_own ? 0 : double{build::node_cost};
        const Node& node = scene_.nodes[object.first_node + child];
        for (std::uint32_t slot = 0; slot < 8; ++slot) {
            const std::uint32_t inner = node.child[slot];
            // By rounding a point may lie outside of its own boxes.
            if (inner != child_empty && (contains(node, slot, at) || holds(inner, own, way)))
                sum += overlap_below(object, inner, at, own, way);
        }
        return sum;
    }

    double overlap_of_leaf(const ObjectRecord& object, std::uint32_t leaf, const Vec3& at,
                           const Point* own) {
        if (kind_of(leaf) != ChildKind::instance) {
            if (own != nullptr) return 0;
            const bool triangles = kind_of(leaf) == ChildKind::triangles;
            return double{triangles ? build::block_cost : build::record_cost} * leaf_count(leaf);
        }
        const InstanceRecord& record = instance(object, leaf);
        if (own != nullptr) {
            const Point& inner = points_[record.object].all[own->below];
            return overlap_at(record.object, inner.at, &inner);
        }
        return double{build::instance_cost} +
               overlap_at(record.object, by_rows(record.to_object).point(at), nullptr);
    }

    const SceneView& scene_;
    const std::uint32_t points_each_;  ///< for an object, at least
    std::vector<Points> points_;       ///< for the objects so far
    Random random_{1};
    std::uint64_t visits_ = 0;
};

}  // namespace

std::vector<double> measure_overlaps(const SceneView& scene) {
    return OverlapMeasurer(scene).measure();
}

double measure_overlap(const SceneView& scene) {
    return OverlapMeasurer(scene).measure_root();
}

}  // namespace raynest
