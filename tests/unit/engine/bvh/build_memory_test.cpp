// The memory of a build while it runs, over what it leaves: nodes, lists of leaves and leaf blocks.
#include "engine/bvh/build.h"
#include "engine/geometry/triangle.h"
#include "tests/conformance/scenes.h"

#include <doctest/doctest.h>
#include <malloc.h>

#include <cstddef>
#include <cstdint>
#include <fstream>
#include <span>
#include <string>
#include <vector>

using namespace raynest;

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
constexpr bool is_instrumented = true;  // shadows of memory would be counted
#else
constexpr bool is_instrumented = false;
#endif

namespace {

/// Bytes of the process that are in memory now (VmRSS), or were at most since the last call of
/// forget_peak (VmHWM).
std::size_t resident(const std::string& field) {
    std::ifstream status("/proc/self/status");
    std::string line;
    while (std::getline(status, line)) {
        if (line.starts_with(field + ":")) return std::stoul(line.substr(field.size() + 1)) << 10;
    }
    return 0;
}
bool forget_peak() {
    std::ofstream clear("/proc/self/clear_refs");
    clear << "5" << std::flush;
    return clear.good();
}

using Triangles = std::vector<Corners>;

/// Small triangles in a cube of the size.
Triangles scattered(std::uint32_t count, float size) {
    conformance::Random random(1);
    Triangles triangles(count);
    for (Corners& triangle : triangles) {
        const Vec3 at =
            size * Vec3(random.between(-1, 1), random.between(-1, 1), random.between(-1, 1));
        for (Vec3& corner : triangle) corner = at + 0.01F * size * random.direction();
    }
    return triangles;
}

Tree build(const Triangles& triangles, BuildQuality quality) {
    const bool clips = quality == BuildQuality::high;
    const PageVector<Corners> corners(triangles.begin(),
                                      clips ? triangles.end() : triangles.begin());
    return build_tree({{},
                       static_cast<std::uint32_t>(triangles.size()),
                       0,
                       0,
                       quality,
                       corners,
                       [&](std::uint32_t first, std::span<Box> out) {
                           for (Box& box : out) {
                               box = {};
                               for (const Vec3& corner : triangles[first++]) box.extend(corner);
                           }
                       }});
}

}  // namespace

TEST_CASE("a build takes at most three times the memory of its result" *
          doctest::skip(is_instrumented)) {
    constexpr std::uint32_t many = 300'000;
    struct Case {
        std::string name;
        Triangles triangles;
    };
    std::vector<Case> cases{
        {"small ones", scattered(many, 1)},
        {"all equal", Triangles(1'000'000, Corners{Vec3(0), Vec3(1, 0, 0), Vec3(0, 1, 0)})},
        {"points in one place", Triangles(many, Corners{Vec3(1), Vec3(1), Vec3(1)})},
        {"boxes with centres beyond all numbers", scattered(many, 3e38F)},
        {"one", scattered(1, 1)}};
    // Nested boxes about one centre.
    Triangles& nested = cases.emplace_back("nested", Triangles(many)).triangles;
    for (std::uint32_t i = 0; i < many; ++i) {
        const auto size = static_cast<float>(i + 1);
        nested[i] = {Vec3(-size), Vec3(size), Vec3(size, -size, size)};
    }
    for (const Case& made : cases) {
        for (const BuildQuality quality :
             {BuildQuality::fast, BuildQuality::medium, BuildQuality::high}) {
            CAPTURE(made.name);
            CAPTURE(static_cast<int>(quality));
            build(made.triangles, quality);  // threads and their pools are there from now on
            malloc_trim(0);                  // else what was freed before hides what is taken now
            const std::size_t before = resident("VmRSS");
            REQUIRE(forget_peak());
            const Tree tree = build(made.triangles, quality);
            const std::size_t taken = resident("VmHWM") - before;
            const std::size_t blocks = tree.block_lanes.size() / 8;
            const std::size_t result = tree.nodes.size() * sizeof(Node) +
                                       tree.block_lanes.size() * sizeof(std::uint32_t) +
                                       blocks * sizeof(TriangleBlock);
            constexpr std::size_t pages = std::size_t{1} << 20;  // what threads and pools add
            CHECK(result != 0);
            CHECK(taken <= 3 * result + pages);
        }
    }
}
