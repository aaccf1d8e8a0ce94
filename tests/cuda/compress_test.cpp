#include "engine/cuda/compress.h"

#include "engine/cuda/traverse.h"
#include "tests/conformance/scenes.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

using namespace raynest;
using conformance::Random;

namespace {

/// Eight boxes within `half` of `middle`, some of them flat.
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

/// How far the decoded boxes reach beyond the true ones, at most, in parts of the node's extent;
/// negative where one does not contain its true box.
float slack(const Node& node, const cuda::CompressedNode& compressed) {
    float most = 0;
    for (std::uint32_t slot = 0; slot < 8; ++slot) {
        const Box box = cuda::CompressedBox{&compressed.boxes, slot}.box_of(0);
        const std::uint32_t c = compressed.child[slot];  // random_node() numbers them
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

/// A tree that is a rope: every node holds a leaf without triangles and the next node.
std::vector<Node> rope(std::uint32_t length) {
    std::vector<Node> nodes(length);
    for (std::uint32_t n = 0; n < length; ++n) {
        nodes[n].order[0] = 0x03000000U;
        std::fill(nodes[n].child, nodes[n].child + 8, child_empty);
        nodes[n].child[0] = make_leaf(ChildKind::records, 0, 1);
        nodes[n].child[1] = n + 1 < length ? n + 1 : make_leaf(ChildKind::records, 0, 1);
    }
    return nodes;
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
                  0.009F);  // a step: twice 1/255 at most, because scales are powers of two
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

TEST_CASE("an axis that fits no grid constrains nothing") {
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
        if (beside) continue;  // the other axes still cull, as far as the grid tells
        CHECK(intersect(view, cuda::CompressedBox{&compressed.boxes, slot}).mask == 1);
    }
}

TEST_CASE("children lie in the slots in which a ray expects them") {
    // One child in each corner, in an order of its own.
    Node node{};
    node.order[0] = 0xFF000000U;
    for (std::uint32_t c = 0; c < 8; ++c) {
        const std::uint32_t corner = (5 * c + 3) % 8;
        node.child[c] = corner;
        for (std::uint32_t axis = 0; axis < 3; ++axis) {
            const float at = (corner >> axis & 1U) != 0 ? 3.0F : -3.0F;
            node.lower[axis][c] = at - 1;
            node.upper[axis][c] = at + 1;
        }
    }
    const cuda::CompressedNode compressed = cuda::compress(node);
    for (std::uint32_t slot = 0; slot < 8; ++slot) CHECK(compressed.child[slot] == slot);
}

TEST_CASE("a scene that needs more stack than there is belongs to the CPU") {
    for (const std::uint32_t length : {cuda::stack_max + 1, cuda::stack_max + 2}) {
        const std::vector<Node> nodes = rope(length);
        ObjectRecord object{};
        object.levels = 1;
        object.root = 0;
        object.node_count = length;
        SceneView scene;
        scene.nodes = nodes.data();
        scene.objects = &object;
        scene.object_count = 1;
        // Nothing waits beside the first node.
        const auto trees = cuda::compress(scene);
        CHECK(trees.has_value() == (length <= cuda::stack_max + 1));
        if (!trees) CHECK(trees.error().code == ErrorCode::limit_exceeded);
    }
}
