// Parts of the built-in forest: materials, textures and the objects that are placed.
#pragma once

#include "engine/math/random.h"
#include "engine/scene/description.h"

#include <cstdint>
#include <numbers>
#include <vector>

namespace raynest::forest {

inline constexpr float pi = std::numbers::pi_v<float>;

enum MaterialId : std::uint32_t {
    ground,
    bark,
    birch_bark,
    leaf_light,
    leaf_mid,
    leaf_dark,
    leaf_amber,
    birch_leaf,
    needles,
    fern,
    grass,
    rock,
    material_count
};

/// Fills scene.materials (indexed by MaterialId), scene.textures and scene.images.
void add_materials(SceneDescription& scene, std::uint64_t seed);

/// Returns a placement: `scale` first, then a turn about +Y, a tilt towards +X, and the position.
Transform place(const Vec3& position, float scale, float turn, float tilt = 0);

/// Returns a ball of `cards` leaf cards, about one metre across. A card is two triangles.
ObjectDescription leaf_cluster(Random random, std::uint32_t cards, MaterialId material);
/// Returns a spray of needles one metre long along +X.
ObjectDescription needle_bough(Random random);
ObjectDescription fern_plant(Random random);
ObjectDescription grass_tuft(Random random);
ObjectDescription boulder(std::uint64_t seed);

/// A broad-leaved tree: trunk and limbs of its own, leaf clusters placed on them. `clusters` are
/// the objects to place, darkest first; the lighter ones go higher on the tree.
struct BroadleafShape {
    float height;
    float trunk_radius;
    float crown_start;  ///< share of the height below which there are no limbs
    float spread;       ///< length of the longest limbs over the height
    float rise;         ///< how steeply limbs go up, 0..1
    std::uint32_t limbs;
    MaterialId bark;
    float cluster_scale;
};
ObjectDescription broadleaf(Random random, const BroadleafShape& shape,
                            const std::vector<std::uint32_t>& clusters);
/// Returns a spruce of `height` metres made of whorls of boughs.
ObjectDescription spruce(Random random, float height, const std::vector<std::uint32_t>& boughs);

/// Returns the height of the forest floor at a place, in metres.
float floor_height(float x, float z);
/// Returns the floor as a disc-shaped grid around the clearing, finest there.
ObjectDescription floor_mesh(float radius);

}  // namespace raynest::forest
