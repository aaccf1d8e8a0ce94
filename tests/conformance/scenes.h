// Scenes and rays that try to make a traversal disagree with the reference.
#pragma once

#include "engine/geometry/ray.h"
#include "engine/scene/description.h"

#include <array>
#include <bit>
#include <cstdint>
#include <vector>

namespace raynest::conformance {

/// A small seeded generator; every run gets the same input.
class Random {
public:
    explicit Random(std::uint64_t seed) : state_(seed * 0x9E3779B97F4A7C15ULL + 1) {}
    std::uint32_t bits() {
        state_ = state_ * 6364136223846793005ULL + 1442695040888963407ULL;
        const auto x = static_cast<std::uint32_t>((state_ >> 18 ^ state_) >> 27);
        const auto turn = static_cast<std::uint32_t>(state_ >> 59);
        return std::rotr(x, static_cast<int>(turn));
    }
    float unit() { return static_cast<float>(bits() >> 8) * 0x1p-24F; }
    float between(float low, float high) { return low + (high - low) * unit(); }
    std::uint32_t below(std::uint32_t n) { return bits() % n; }
    Vec3 in_box(float half) {
        return {between(-half, half), between(-half, half), between(-half, half)};
    }
    Vec3 direction();

private:
    std::uint64_t state_;
};

/// Returns masked, blended and opaque triangles with textures, plus degenerate triangles, under
/// `depth` BVHs: depth - 1 levels of rotated, scaled, sheared and mirrored instances. Each level
/// holds geometry of its own besides its instances, so hits occur at every depth. From depth 2 on
/// there is an object of spheres too, and each level of instances has one with a singular transform
/// and one with a mask of zero.
SceneDescription nested_scene(std::uint32_t depth, std::uint64_t seed);

/// Returns 27 cubes in a grid, which touch with whole faces, and inside a root with triangles of its
/// own. Each is placed three times with one box, so that hits tie: as it is, mirrored, and with its
/// axes exchanged. Others lean over their neighbours, and one is as large as the grid.
SceneDescription crowded_scene(std::uint64_t seed, BuildQuality build);

/// Returns a BVH of spheres: two hits per primitive.
SceneDescription sphere_scene(std::uint64_t seed);

/// Returns one mesh of triangles up to 1000 times as long as high, at random in a box: their boxes
/// overlap a lot, and a high build cuts them.
SceneDescription needles(std::uint32_t count, std::uint64_t seed);

/// Returns one mesh of `triangles` connected triangles (a bent sheet): many shared edges and
/// vertices.
SceneDescription sheet_scene(std::uint32_t triangles, std::uint32_t depth, std::uint64_t seed);

/// Returns the corners, in world space, of a random triangle of the scene.
std::array<Vec3, 3> random_triangle(const SceneDescription& scene, Random& random);
/// Returns a world-space point on a random edge or vertex of a random triangle of the scene.
Vec3 random_edge_point(const SceneDescription& scene, Random& random);

/// Returns rays in random directions from around the scene, some with short intervals.
std::vector<Ray> random_rays(std::uint32_t count, float half, Random& random);
/// Returns rays through edges and vertices.
std::vector<Ray> edge_rays(const SceneDescription& scene, std::uint32_t count, float half,
                           Random& random);
/// Returns packets of 64 rays from one point each, through the edges of one triangle and close to
/// them. In some packets a few rays aim elsewhere, are short or are invalid.
std::vector<Ray> pinhole_rays(const SceneDescription& scene, std::uint32_t count, Random& random);
/// Returns axis-parallel, zero, non-finite, denormal, reversed, enormous and tiny rays.
std::vector<Ray> odd_rays(std::uint32_t count, float half, Random& random);

}  // namespace raynest::conformance
