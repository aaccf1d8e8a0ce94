// What the built-in forest is made of: materials, textures and the objects that are placed.
#pragma once

#include "engine/math/random.h"
#include "engine/scene/description.h"

#include <cstdint>
#include <vector>

namespace raynest::forest {

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

/// Places an object: `scale` first, then a turn about +Y, a tilt towards +X, and the position.
Transform place(const Vec3& position, float scale, float turn, float tilt = 0);

/// A ball of `cards` leaf cards of about one metre across. Cards are two triangles each.
ObjectDescription leaf_cluster(Random random, std::uint32_t cards, MaterialId material);
/// A spray of needles one metre long along +X.
ObjectDescription needle_bough(Random random);
ObjectDescription fern_plant(Random random);
ObjectDescription grass_tuft(Random random);
ObjectDescription boulder(std::uint64_t seed);

/// A broad-leaved tree: trunk and limbs of its own, leaf clusters placed on them. `clusters` are
/// the objects to place, darkest first; the higher on the tree, the lighter.
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
/// A spruce of `height` metres made of whorls of boughs.
ObjectDescription spruce(Random random, float height, const std::vector<std::uint32_t>& boughs);

/// Height of the forest floor at a place, metres.
float floor_height(float x, float z);
/// The floor as a disc-shaped grid around the clearing, finest there.
ObjectDescription floor_mesh(float radius);

}  // namespace raynest::forest
