#include "engine/cuda/compress.h"

#include "engine/cuda/traverse.h"
#include "engine/geometry/triangle.h"
#include "engine/queries/queries.h"
#include "tests/conformance/scenes.h"
#include "tests/cuda/binary_trees.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cstdint>
#include <functional>
#include <limits>
#include <utility>
#include <vector>

using namespace raynest;
using conformance::Random;

namespace {

/// Returns eight boxes within `half` of `middle`, some of them flat.
Node random_node(Random& random, const Vec3& middle, float half) {
    Node node{};
    node.order[0] = 0xFF000000U;
    for (std::uint32_t slot = 0; slot < 8; ++slot) {
        node.child[slot] = slot;
        for (int axis = 0; axis < 3; ++axis) {
            const float a = middle[axis] + random.between(-half, half);
            const float b = random.below(4) == 0 ? a : middle[axis] + random.between(-half, half);
            node.lower[axis][slot] = std::min(a, b);
            node.upper[axis][slot] = std::max(a, b);
        }
    }
    return node;
}

/// Returns how far the decoded boxes extend beyond the true ones, at most, as a share of the node's
/// extent; negative if one does not contain its true box.
float slack(const Node& node, const cuda::CompressedNode& compressed) {
    float most = 0;
    for (std::uint32_t slot = 0; slot < 8; ++slot) {
        const Box box = cuda::CompressedBox{&compressed.boxes, slot}.box_of(0);
        const std::uint32_t c = compressed.child[slot];  // random_node() numbers the children
        for (int axis = 0; axis < 3; ++axis) {
            const auto [low, high] =
                std::pair{*std::min_element(node.lower[axis], node.lower[axis] + 8),
                          *std::max_element(node.upper[axis], node.upper[axis] + 8)};
            if (!(box.lower[axis] <= node.lower[axis][c])) return -1;
            if (!(box.upper[axis] >= node.upper[axis][c])) return -1;
            const float extent = high - low;
            const float beyond = std::max(node.lower[axis][c] - box.lower[axis],
                                          box.upper[axis] - node.upper[axis][c]);
            if (extent > 0) most = std::max(most, beyond / extent);
        }
    }
    return most;
}

/// Returns a node with a child in each corner; the corner's number is the child word.
template <class CornerOf>
Node corners(CornerOf&& corner_of) {
    Node node{};
    node.order[0] = 0xFF000000U;
    for (std::uint32_t c = 0; c < 8; ++c) {
        node.child[c] = corner_of(c);
        for (std::uint32_t axis = 0; axis < 3; ++axis) {
            const float at = (corner_of(c) >> axis & 1U) != 0 ? 3.0F : -3.0F;
            node.lower[axis][c] = at - 1;
            node.upper[axis][c] = at + 1;
        }
    }
    return node;
}

/// Returns a tree that is a chain: the first corner of every node holds the next node, and the
/// other corners hold the same leaf.
std::vector<Node> rope(std::uint32_t length) {
    std::vector<Node> nodes(length, corners(std::identity{}));
    for (std::uint32_t n = 0; n < length; ++n) {
        std::fill(nodes[n].child, nodes[n].child + 8, make_leaf(ChildKind::triangles, 0, 1));
        if (n + 1 < length) nodes[n].child[0] = n + 1;
    }
    return nodes;
}

/// Enters every box and counts the boxes.
struct EveryBox {
    std::uint32_t asked = 0;

    auto operator()(const auto& ray, const BoxLike auto& boxes) {
        ++asked;
        auto spans = intersect(ray, boxes);
        spans.mask = boxes.valid();
        return spans;
    }
};

/// Counts the boxes tested by a ray that meets the first corner first.
template <class Trees>
std::uint32_t boxes_asked(const SceneView& scene, const Trees& trees) {
    Ray ray;
    ray.origin = Vec3(-9);
    ray.direction = Vec3(1);
    RayView view = outermost_view(ray, &scene, 0, 0xFFFFFFFFU, 0);
    view.object = scene.objects;
    EveryBox isect;
    ClosestHit query;
    CHECK(cuda::traverse_levels(view, trees, isect, query));
    return isect.asked;
}

}  // namespace

TEST_CASE("a decoded box contains the true one and is little larger") {
    Random random(11);
    for (const float scale : {1.0F, 1e-30F, 1e-3F, 1e15F, 1e30F}) {
        for (int i = 0; i < 500; ++i) {
            const Node node = random_node(random, scale * random.in_box(1), scale);
            const float beyond = slack(node, cuda::compress(node));
            CHECK(beyond >= 0);
            CHECK(beyond <=
                  0.009F);  // a step: at most twice 1/255, because scales are powers of two
        }
    }
}

TEST_CASE("boxes that are small and far away are still contained") {
    Random random(12);
    for (int i = 0; i < 500; ++i) {
        const Node node = random_node(random, 1e6F * random.in_box(1), 0.1F);
        CHECK(slack(node, cuda::compress(node)) >= 0);
    }
}

TEST_CASE("an axis that fits no grid limits nothing") {
    Random random(13);
    Node node = random_node(random, Vec3(0), 1);
    node.upper[1][3] = std::numeric_limits<float>::infinity();
    const cuda::CompressedNode compressed = cuda::compress(node);
    Ray ray;
    ray.origin = Vec3(0, 1e6F, 0);
    ray.direction = Vec3(0, 1, 0);
    ray.tmax = 1;
    const BoxRay view(outermost_view(ray, nullptr, 0, 0, 0));
    for (std::uint32_t slot = 0; slot < 8; ++slot) {
        const std::uint32_t c = compressed.child[slot];
        const bool beside = node.lower[0][c] > 0 || node.upper[0][c] < 0 || node.lower[2][c] > 0 ||
                            node.upper[2][c] < 0;
        if (beside) continue;  // the other axes still cull, as precisely as the grid allows
        CHECK(intersect(view, cuda::CompressedBox{&compressed.boxes, slot}).mask == 1);
    }
}

TEST_CASE("children lie in the slots in which a ray expects them") {
    const auto corner_of = [](std::uint32_t c) { return (5 * c + 3) % 8; };
    const cuda::CompressedNode compressed = cuda::compress(corners(corner_of));
    for (std::uint32_t slot = 0; slot < 8; ++slot) CHECK(compressed.child[slot] == slot);
}

TEST_CASE("a scene that needs more stack than there is runs on the CPU") {
    TriangleBlock block{};
    std::fill(block.triangle, block.triangle + 8, no_id);
    // Nothing waits beside the first node.
    constexpr std::uint32_t longest = cuda::CompressedTrees::stack_max + 1;
    for (const std::uint32_t length : {longest, longest + 1}) {
        const std::vector<Node> nodes = rope(length);
        ObjectRecord object{};
        object.levels = 1;
        object.origin_error = 1;
        object.node_count = length;
        object.block_count = 1;
        SceneView scene;
        scene.nodes = nodes.data();
        scene.blocks = &block;
        scene.objects = &object;
        scene.object_count = 1;
        const auto trees = cuda::compress(scene);
        CHECK(trees.has_value() == (length <= longest));
        if (!trees) {
            CHECK(trees.error().code == ErrorCode::limit_exceeded);
            continue;
        }
        // Both traversals fill their stacks, reach the end of the chain and return.
        CHECK(boxes_asked(scene, trees->view()) == 8 * length);
        CHECK(boxes_asked(scene, cuda::BinaryTrees(scene)) == 14 * length);
    }
}
