// Builds the 8-wide tree of one object.
//
//   boxes ──build_binary──► binary tree ──build_emit──► 8-wide nodes, leaves
//            │ where to split: build_split (binned SAH), build_cells (the same over cells, upper
//            │ levels of large medium builds), build_morton (of fast builds), build_spatial (of high
//            │ builds)
//            └ how to collapse: build_cut (cheapest cut), on the way back up
//              (the loops of build_split: build_loops, compiled for each CPU target)
//
// Parallel (oneTBB, in the caller's arena) and deterministic: the same input gives the same bytes,
// for any number of threads.
#pragma once

#include "engine/bvh/node.h"
#include "engine/bvh/page_vector.h"
#include "engine/geometry/box.h"

#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <span>

namespace raynest {

/// How much time a build may take for how good a tree. Against medium, measured on a terrain, loose
/// cards and an interior of long triangles: fast takes 0.7 of the time, its SAH cost is 10 to 28 %
/// higher, rays are 5 to 20 % slower. high takes 4, 14 and 5 times as long; SAH cost -0.5, -5 and
/// -27 %, rays of the interior 1.25 to 1.5 times as fast, of the others as before.
enum class BuildQuality : std::uint32_t { fast, medium, high };
inline constexpr std::array<const char*, 3> build_quality_names{"fast", "medium", "high"};

/// The vertices of a triangle.
using Corners = std::array<Vec3, 3>;

/// Items are numbered triangles or records first, never both kinds (ObjectRecord), then instances.
/// An item with an empty or non-finite box is left out of the tree: it can never be hit.
struct TreeInput {
    std::span<const Box> boxes;  ///< of all items, or where `triangle_boxes` is set of the others
    std::uint32_t triangle_count = 0;
    std::uint32_t record_count = 0;
    std::uint32_t instance_count = 0;
    BuildQuality quality = BuildQuality::medium;
    /// One per triangle for a high build of triangles alone; any other is a medium one. It may name
    /// a triangle in several leaves; at most every second one on average.
    std::span<const Corners> corners = {};
    /// Writes the boxes of triangles from `first` on; called by several threads at once. So boxes
    /// are made where they are used, and no array of them is kept.
    std::function<void(std::uint32_t first, std::span<Box> out)> triangle_boxes = {};

    [[nodiscard]] std::size_t size() const {
        return std::size_t{triangle_count} + record_count + instance_count;
    }
};

struct Tree {
    PageVector<Node> nodes;
    std::uint32_t root = child_empty;  ///< child word; a tree without items stays empty
    Box bounds;
    /// Triangle of lane l of block b at [8 b + l], no_id in padding lanes. Within a leaf
    /// ascending.
    PageVector<std::uint32_t> block_lanes;
    /// Record at each place of the tree's record array.
    PageVector<std::uint32_t> record_order;
    double sah_cost = 0;
    std::uint32_t height = 0;  ///< nodes on the longest path
};

Tree build_tree(const TreeInput& input);

}  // namespace raynest
