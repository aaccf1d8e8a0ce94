// Tests the builder: every item is in the tree once, inside its boxes, within the limits of node.h.
#include "engine/bvh/build.h"

#include "engine/bvh/build_binary.h"
#include "engine/bvh/build_emit.h"
#include "engine/geometry/hit.h"
#include "tests/conformance/scenes.h"

#include <doctest/doctest.h>
#include <tbb/global_control.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <map>
#include <vector>

using namespace raynest;

namespace {

std::vector<Box> random_boxes(std::uint32_t count, conformance::Random& random) {
    std::vector<Box> boxes(count);
    for (Box& box : boxes) {
        box.extend(random.in_box(10));
        box.extend(box.lower + Vec3(random.unit(), random.unit(), random.unit()));
    }
    return boxes;
}

void check_same(const Tree& one, const Tree& other) {
    REQUIRE(one.nodes.size() == other.nodes.size());
    CHECK(std::memcmp(one.nodes.data(), other.nodes.data(), one.nodes.size() * sizeof(Node)) == 0);
    CHECK(one.block_lanes == other.block_lanes);
    CHECK(one.record_order == other.record_order);
    CHECK(one.sah_cost == other.sah_cost);
}

struct Walk {
    const TreeInput& input;
    const Tree& tree;
    std::map<std::uint32_t, int> seen;  // item -> times
    std::uint32_t height = 0;

    void item(std::uint32_t id, const Box& around) {
        ++seen[id];
        const Box& box = input.boxes[id];
        for (int axis = 0; axis < 3; ++axis) {
            CHECK(box.lower[axis] >= around.lower[axis]);
            CHECK(box.upper[axis] <= around.upper[axis]);
        }
    }

    void visit(std::uint32_t child, const Box& around, std::uint32_t depth) {
        if (!is_leaf(child)) {
            height = std::max(height, depth);
            const Node& node = tree.nodes.at(child);
            CHECK(node.valid() != 0);
            for (std::uint32_t slot = 0; slot < 8; ++slot) {
                const bool valid = (node.valid() >> slot & 1U) != 0;
                CHECK(valid == (node.child[slot] != child_empty));
                if (!valid) continue;
                if (!is_leaf(node.child[slot])) CHECK(node.child[slot] > child);  // parents first
                Box box;
                for (int axis = 0; axis < 3; ++axis) {
                    box.lower[axis] = node.lower[axis][slot];
                    box.upper[axis] = node.upper[axis][slot];
                    CHECK(box.lower[axis] >= around.lower[axis]);
                    CHECK(box.upper[axis] <= around.upper[axis]);
                }
                visit(node.child[slot], box, depth + 1);
            }
            return;
        }
        if (kind_of(child) == ChildKind::instance) {
            item(input.triangle_count + input.record_count + leaf_instance(child), around);
            return;
        }
        const bool triangles = kind_of(child) == ChildKind::triangles;
        for (std::uint32_t i = 0; i < leaf_count(child); ++i) {
            const std::uint32_t at = leaf_first(child) + i;
            if (!triangles) {
                item(input.triangle_count + tree.record_order.at(at), around);
                continue;
            }
            for (std::uint32_t lane = 0; lane < 8; ++lane) {
                const std::uint32_t id = tree.block_lanes.at(8 * at + lane);
                if (id != no_id) item(id, around);
            }
        }
    }
};

Walk walk(const TreeInput& input, const Tree& tree) {
    Walk walk{input, tree, {}};
    if (tree.root != child_empty) walk.visit(tree.root, tree.bounds, 1);
    return walk;
}

}  // namespace

TEST_CASE("every item is in the tree exactly once and inside the boxes above it") {
    conformance::Random random(1);
    for (const std::uint32_t count : {1U, 2U, 8U, 9U, 100U, 5000U}) {
        const auto boxes = random_boxes(3 * count, random);
        for (const TreeInput& input :
             {TreeInput{boxes, 3 * count, 0, 0}, TreeInput{boxes, 2 * count, 0, count},
              TreeInput{boxes, 0, 2 * count, count}, TreeInput{boxes, 0, 0, 3 * count}}) {
            const Tree tree = build_tree(input);
            const Walk walked = walk(input, tree);
            CHECK(walked.seen.size() == boxes.size());
            CHECK(std::all_of(walked.seen.begin(), walked.seen.end(),
                              [](const auto& item) { return item.second == 1; }));
            CHECK(walked.height == tree.height);
        }
    }
}

TEST_CASE("the octant order lists every valid slot once, near to far along the diagonal") {
    conformance::Random random(2);
    const auto boxes = random_boxes(400, random);
    const Tree tree = build_tree({boxes, 400, 0, 0});
    for (const Node& node : tree.nodes) {
        const int children = std::popcount(node.valid());
        for (std::uint32_t octant = 0; octant < 8; ++octant) {
            std::uint32_t listed = 0;
            float last = -std::numeric_limits<float>::infinity();
            for (int i = 0; i < children; ++i) {
                const std::uint32_t slot = node.order[i] >> (3 * octant) & 7U;
                listed |= 1U << slot;
                float along = 0;
                for (std::uint32_t axis = 0; axis < 3; ++axis) {
                    const float center =
                        0.5F * node.lower[axis][slot] + 0.5F * node.upper[axis][slot];
                    along += (octant >> axis & 1U) != 0 ? -center : center;
                }
                CHECK(along >= last - 1e-4F);
                last = along;
            }
            CHECK(listed == node.valid());
        }
    }
}

TEST_CASE("coincident, flat and enormous items give a tree of bounded height") {
    conformance::Random random(3);
    std::vector<Box> boxes(3000, Box{Vec3(1), Vec3(1)});
    const Tree coincident = build_tree({boxes, 3000, 0, 0});
    CHECK(walk({boxes, 3000, 0, 0}, coincident).seen.size() == 3000);
    CHECK(coincident.height <= tree_height_max);

    // Each box is twice as far as the one before: with binary splits the tree would be 3000 deep.
    for (std::size_t i = 0; i < boxes.size(); ++i) {
        const float at = std::ldexp(1.0F, static_cast<int>(i % 98) - 49);
        boxes[i] = {Vec3(at, 0, 0), Vec3(at, at, 0)};
    }
    const Tree skewed = build_tree({boxes, 3000, 0, 0});
    CHECK(walk({boxes, 3000, 0, 0}, skewed).seen.size() == 3000);
    CHECK(skewed.height <= tree_height_max);
}

TEST_CASE("items without a finite box are left out, and no items give an empty tree") {
    const float inf = std::numeric_limits<float>::infinity();
    const std::vector<Box> boxes{Box{}, Box{Vec3(0), Vec3(inf)}, Box{Vec3(0), Vec3(1)},
                                 Box{Vec3(std::nanf("")), Vec3(1)}};
    const Tree tree = build_tree({boxes, 4, 0, 0});
    CHECK(walk({boxes, 4, 0, 0}, tree).seen == std::map<std::uint32_t, int>{{2, 1}});
    CHECK(build_tree({}).root == child_empty);
}

TEST_CASE("the same input gives the same bytes on 1, 2, 3 and 8 threads") {
    // So many that the passes over the items of one node are parallel, and that medium builds begin
    // with cells.
    for (const std::uint32_t count : {40'000U, 200'000U}) {
        conformance::Random random(4);
        const auto boxes = random_boxes(count, random);
        std::vector<Corners> corners(count);
        for (std::uint32_t i = 0; i < count; ++i) {
            corners[i] = {boxes[i].lower, boxes[i].upper,
                          Vec3(boxes[i].lower.x, boxes[i].upper.y, boxes[i].lower.z)};
        }
        for (const BuildQuality quality :
             {BuildQuality::fast, BuildQuality::medium, BuildQuality::high}) {
            const TreeInput input{boxes, count, 0, 0, quality, corners};
            const auto build_on = [&](std::size_t threads) {
                const tbb::global_control limit(tbb::global_control::max_allowed_parallelism,
                                                threads);
                return build_tree(input);
            };
            const Tree one = build_on(1);
            for (const std::size_t threads : {2U, 3U, 8U}) {
                CAPTURE(count);
                CAPTURE(static_cast<int>(quality));
                CAPTURE(threads);
                check_same(one, build_on(threads));
            }
            if (quality != BuildQuality::high) CHECK(walk(input, one).seen.size() == count);
        }
    }
}

TEST_CASE("boxes that are made where they are used give the same bytes") {
    conformance::Random random(6);
    constexpr std::uint32_t count = 10'000, others = 300;
    auto boxes = random_boxes(count + others, random);
    for (std::uint32_t i = 0; i < count; i += 3) boxes[i] = Box{};  // gaps, which are closed
    const std::span<const Box> all(boxes);
    const auto triangles = [&](std::uint32_t first, std::span<Box> out) {
        std::ranges::copy(all.subspan(first, out.size()), out.begin());
    };
    const Tree made =
        build_tree({all.subspan(count), count, 0, others, BuildQuality::medium, {}, triangles});
    check_same(build_tree({all, count, 0, others}), made);
    CHECK(walk({all, count, 0, others}, made).seen.size() == count - (count + 2) / 3 + others);
}

TEST_CASE("the loops of every CPU target give the same bytes") {
    const auto tree_of = [](const TreeInput& input, const build::Loops& loops) {
        build::BinaryTree binary(input, loops);
        Tree tree;
        tree.sah_cost = static_cast<double>(binary.build());
        build::emit(binary, tree);
        return tree;
    };
    conformance::Random random(5);
    auto boxes = random_boxes(150'000, random);
    // Boxes of extreme size, in equal places, flat, and at zeros of both signs.
    for (std::size_t i = 0; i < boxes.size(); i += 7) {
        const float at = std::ldexp(1.0F, static_cast<int>(i % 250) - 125);
        boxes[i] = {Vec3(-at, i % 2 == 0 ? 0.0F : -0.0F, at), Vec3(at, 0, at)};
    }
    const auto count = static_cast<std::uint32_t>(boxes.size());
    for (const TreeInput& input :
         {TreeInput{boxes, count, 0, 0}, TreeInput{boxes, 0, count, 0},
          TreeInput{boxes, 0, 0, count}, TreeInput{boxes, count, 0, 0, BuildQuality::fast}}) {
        const Tree baseline = tree_of(input, build::loops().front());
        for (const build::Loops& loops : build::loops().subspan(1)) {
            CAPTURE(loops.target);
            check_same(baseline, tree_of(input, loops));
        }
    }
}
