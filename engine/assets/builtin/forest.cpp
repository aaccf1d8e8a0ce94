// builtin:forest, the title picture: a clearing in a mixed wood.
//
//   scene -> stand (a patch of wood) -> tree (trunk and limbs) -> leaves (a ball of leaf cards)
//         -> thicket (a patch of undergrowth) -> fern, grass
//
// Four levels, some twenty different objects, millions of triangles placed. The alpha of the leaf
// cards decides what a camera sees: without the mask the trees are heaps of squares.
//
// With wind each tree sways by itself, so those of a stand are placed by the scene.
#include "engine/assets/builtin/builtin.h"
#include "engine/assets/builtin/forest_parts.h"
#include "engine/assets/builtin/look_at.h"
#include "engine/assets/builtin/play.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

namespace raynest {
namespace {

using namespace forest;

constexpr float clearing_radius = 13;
constexpr float stand_radius = 9;
constexpr std::uint32_t trees_per_stand = 16;
constexpr std::uint32_t stand_variants = 4;
/// Trees round the clearing, from left to right as the first camera sees them: indices into
/// Planter::trees_. Pale trunks and one dark spruce stand before the green of the stands.
constexpr std::uint32_t clearing_kinds[] = {6, 0, 5, 4, 6, 1, 5, 7, 6, 4, 5, 0, 8, 6, 4, 1};
/// Undergrowth is placed only where a camera near the clearing can see it.
constexpr float thicket_reach = 38;
constexpr std::uint64_t flat_triangles_max = 20'000'000;
constexpr std::uint64_t windy_trees_max = 20'000;  ///< each has keys of its own

Vec3 clearing_eye() {
    return {0.5F, floor_height(0.5F, 13) + 1.65F, 13};
}

class Planter {
public:
    Planter(SceneDescription& scene, std::uint64_t seed, std::uint32_t cards, bool is_windy)
        : scene_(scene),
          random_(seed),
          is_windy_(is_windy) {
        grow(cards);
    }

    /// Plants the wood: single trees round the clearing, then whole stands outwards.
    ObjectDescription plant(std::uint64_t trees) {
        ObjectDescription root;
        root.name = "forest";
        const std::uint64_t singles = std::min<std::uint64_t>(trees, 8 + trees % trees_per_stand);
        const std::uint64_t stands = (trees - singles) / trees_per_stand;
        const std::uint64_t left = trees - singles - stands * trees_per_stand;

        // Give each stand an equal area: the spiral of a sunflower's seeds.
        const float spacing = 2 * stand_radius * 0.92F;
        const auto spiral = [&](std::uint64_t i) {
            const float inner = clearing_radius + stand_radius;
            const float r =
                std::sqrt(inner * inner + spacing * spacing / pi * static_cast<float>(i));
            const float angle = 2.39996F * static_cast<float>(i) + 0.4F;
            return Vec3(r * std::cos(angle), 0, r * std::sin(angle));
        };
        const float reach = glm::length(spiral(stands)) + 2 * stand_radius;
        add(root, add_object(floor_mesh(reach + 30)), Transform{}, "floor");

        // Leave the south open: the camera stands there.
        for (std::uint64_t i = 0; i < singles + left; ++i) {
            const float share = (static_cast<float>(i) + random_.uniform(0.2F, 0.8F)) /
                                static_cast<float>(singles + left);
            const float angle = pi / 2 + 0.75F + (2 * pi - 1.5F) * share;
            const float r = clearing_radius + random_.uniform(-2.5F, 1.5F);
            add_tree(root, {r * std::cos(angle), 0, r * std::sin(angle)},
                     clearing_kinds[i % std::size(clearing_kinds)]);
        }
        for (std::uint64_t i = 0; i < stands; ++i) {
            const Vec3 at =
                spiral(i) + Vec3(random_.uniform(-1.5F, 1.5F), 0, random_.uniform(-1.5F, 1.5F));
            const Transform placed =
                on_floor(at, random_.uniform(0.92F, 1.1F), random_.uniform(0, 2 * pi));
            add_stand(root, stands_[random_.below(stand_variants)], placed);
        }
        plant_undergrowth(root, std::min(reach, thicket_reach));
        frame(root);
        return root;
    }

private:
    std::uint32_t add_object(ObjectDescription object) {
        scene_.objects.push_back(std::move(object));
        return static_cast<std::uint32_t>(scene_.objects.size() - 1);
    }

    static void add(ObjectDescription& parent, std::uint32_t object, const Transform& transform,
                    const char* name) {
        const auto number = static_cast<std::uint32_t>(parent.instances.size());
        parent.instances.push_back(
            {object, transform, 0xFFFFFFFFU, number, name + ('-' + std::to_string(number))});
    }

    static Transform on_floor(Vec3 at, float scale, float turn) {
        at.y = floor_height(at.x, at.z);
        return place(at, scale, turn);
    }

    void add_tree(ObjectDescription& parent, const Vec3& at, std::uint32_t kind) {
        add(parent, trees_[kind],
            on_floor(at, random_.uniform(0.85F, 1.2F), random_.uniform(0, 2 * pi)),
            scene_.objects[trees_[kind]].name.c_str());
    }

    void add_stand(ObjectDescription& parent, std::uint32_t stand, const Transform& at) {
        if (!is_windy_) return add(parent, stand, at, "stand");
        for (const InstanceDescription& tree : scene_.objects[stand].instances)
            add(parent, tree.object, compose(at, tree.transform),
                scene_.objects[tree.object].name.c_str());
    }

    /// Makes every object that is placed, once.
    void grow(std::uint32_t cards) {
        const auto clusters = [&](std::initializer_list<MaterialId> tones) {
            std::vector<std::uint32_t> objects;
            for (const MaterialId tone : tones) {
                objects.push_back(add_object(leaf_cluster(random_.split(), cards, tone)));
            }
            return objects;
        };
        oak_leaves_ = clusters({leaf_dark, leaf_mid, leaf_mid, leaf_light});
        const auto dark_leaves = clusters({leaf_dark, leaf_dark, leaf_mid});
        const auto amber_leaves = clusters({leaf_mid, leaf_amber, leaf_amber});
        const auto birch_leaves = clusters({birch_leaf, birch_leaf});
        const std::vector<std::uint32_t> boughs{add_object(needle_bough(random_.split())),
                                                add_object(needle_bough(random_.split()))};

        const BroadleafShape oak{9.5F, 0.34F, 0.26F, 0.4F, 0.55F, 11, bark, 1.25F};
        const BroadleafShape beech{13, 0.3F, 0.3F, 0.27F, 0.9F, 14, bark, 1.2F};
        const BroadleafShape maple{8, 0.24F, 0.3F, 0.34F, 0.7F, 10, bark, 1.15F};
        const BroadleafShape birch{10.5F, 0.15F, 0.35F, 0.2F, 1.2F, 12, birch_bark, 0.95F};
        const auto tree = [&](const char* name, ObjectDescription object) {
            object.name = name;
            trees_.push_back(add_object(std::move(object)));
        };
        tree("oak", broadleaf(random_.split(), oak, oak_leaves_));
        tree("oak", broadleaf(random_.split(), oak, oak_leaves_));
        tree("beech", broadleaf(random_.split(), beech, dark_leaves));
        tree("beech", broadleaf(random_.split(), beech, oak_leaves_));
        tree("maple", broadleaf(random_.split(), maple, amber_leaves));
        tree("birch", broadleaf(random_.split(), birch, birch_leaves));
        tree("birch", broadleaf(random_.split(), birch, birch_leaves));
        tree("spruce", spruce(random_.split(), 15, boughs));
        tree("spruce", spruce(random_.split(), 11, boughs));

        ferns_ = add_object(fern_plant(random_.split()));
        const std::uint32_t tuft = add_object(grass_tuft(random_.split()));
        boulder_ = add_object(boulder(random_.next()));
        for (std::uint32_t variant = 0; variant < 3; ++variant) {
            ObjectDescription thicket;
            thicket.name = "thicket";
            for (std::uint32_t i = 0; i < 26; ++i) {
                const bool is_fern = i < 2 + 2 * variant;
                add(thicket, is_fern ? ferns_ : tuft,
                    place({random_.uniform(-1.6F, 1.6F), 0, random_.uniform(-1.6F, 1.6F)},
                          random_.uniform(0.7F, 1.2F), random_.uniform(0, 2 * pi)),
                    is_fern ? "fern" : "grass");
            }
            thickets_.push_back(add_object(std::move(thicket)));
        }
        for (std::uint32_t variant = 0; variant < stand_variants; ++variant) {
            ObjectDescription stand;
            stand.name = "stand";
            for (std::uint32_t i = 0; i < trees_per_stand; ++i) {
                const float r =
                    stand_radius * std::sqrt((static_cast<float>(i) + 0.5F) / trees_per_stand);
                const float angle = 2.39996F * static_cast<float>(i) + random_.uniform(-0.3F, 0.3F);
                const auto kind = random_.below(static_cast<std::uint32_t>(trees_.size()));
                add(stand, trees_[kind],
                    place({r * std::cos(angle), 0, r * std::sin(angle)},
                          random_.uniform(0.8F, 1.15F), random_.uniform(0, 2 * pi)),
                    scene_.objects[trees_[kind]].name.c_str());
            }
            stands_.push_back(add_object(std::move(stand)));
        }
    }

    void plant_undergrowth(ObjectDescription& root, float reach) {
        for (float z = -reach; z < reach; z += 2.6F) {
            for (float x = -reach; x < reach; x += 2.6F) {
                const Vec3 at(x + random_.uniform(-1, 1), 0, z + random_.uniform(-1, 1));
                const float r = std::sqrt(at.x * at.x + at.z * at.z);
                const std::uint32_t kind = random_.below(8);
                if (r > reach || (r < clearing_radius && kind > 5)) continue;
                add(root, kind == 7 ? boulder_ : thickets_[kind % 3],
                    on_floor(at, random_.uniform(0.8F, 1.2F), random_.uniform(0, 2 * pi)),
                    kind == 7 ? "boulder" : "thicket");
            }
        }
    }

    /// Hangs leaves into the upper left of the first camera's view and puts others into its lower
    /// right: big cards near the eye.
    void frame(ObjectDescription& root) {
        const auto hang = [&](float right, float up, float ahead, std::size_t tone) {
            add(root, oak_leaves_[tone],
                place(clearing_eye() + Vec3(right, up, -ahead), random_.uniform(0.5F, 0.72F),
                      random_.uniform(0, 2 * pi), random_.uniform(-0.5F, 0.5F)),
                "leaves");
        };
        for (std::size_t i = 0; i < 9; ++i) {
            const float s = static_cast<float>(i) / 8;
            hang(-2.4F + 1.9F * s, 1.05F + 0.5F * s + random_.uniform(-0.1F, 0.1F), 2.6F - 0.3F * s,
                 i % 4);
        }
        for (std::size_t i = 0; i < 5; ++i) {
            hang(1.5F + 0.3F * static_cast<float>(i), -0.95F + 0.07F * static_cast<float>(i), 2.9F,
                 i % 4);
        }
    }

    SceneDescription& scene_;
    Random random_;
    std::vector<std::uint32_t> oak_leaves_;
    std::vector<std::uint32_t> trees_;
    std::vector<std::uint32_t> stands_;
    std::vector<std::uint32_t> thickets_;
    std::uint32_t ferns_ = 0;
    std::uint32_t boulder_ = 0;
    const bool is_windy_;
};

/// Lets all that grows sway about its foot, from left to right for the first camera. Gusts travel:
/// what stands downwind sways later. A plant ends as it began, so that a film can be repeated.
std::vector<std::byte> blow(const ObjectDescription& root, float strength, float seconds,
                            Random random) {
    constexpr float gust_length = 45;  // metres
    Play play(seconds);
    for (std::uint32_t i = 0; i < root.instances.size(); ++i) {
        const InstanceDescription& plant = root.instances[i];
        const bool is_low = plant.name.starts_with("thicket") || plant.name.starts_with("leaves");
        if (plant.name.starts_with("floor") || plant.name.starts_with("boulder")) continue;
        const Transform& at = plant.transform;
        const Vec3 foot(at.m[3], at.m[7], at.m[11]);
        const float angle = strength * random.uniform(0.008F, 0.016F) * (is_low ? 2.0F : 1.0F);
        const float rocks = std::round(seconds / random.uniform(1.5F, 3.5F));
        play.follow(play.add_sway(foot, {0, 0, -1}, angle, seconds / std::max(rocks, 1.0F),
                                  random.uniform(0, 0.25F) - foot.x / gust_length),
                    i, at);
    }
    return play.bytes();
}

}  // namespace

Result<SceneDescription> describe_forest(const BuiltinValues& values) {
    const auto value = [&](const char* key) { return values.find(key)->second; };
    SceneDescription scene;
    const std::uint64_t wind = value("wind");
    if (wind != 0 && (value("levels") == 1 || value("trees") > windy_trees_max))
        return fail(
            ErrorCode::scene_invalid,
            fmt::format("builtin:forest has wind in 2 to 4 levels and for at most {} trees: "
                        "each of them sways by itself",
                        windy_trees_max));
    forest::add_materials(scene, value("seed"));
    Planter planter(scene, value("seed"), static_cast<std::uint32_t>(value("leaves")), wind != 0);
    ObjectDescription root = planter.plant(value("trees"));
    scene.root = static_cast<std::uint32_t>(scene.objects.size());
    scene.objects.push_back(std::move(root));

    scene.cameras.push_back(
        look_at("clearing", clearing_eye(), clearing_eye() + Vec3(-0.6F, 1.7F, -15), 0.85F));
    scene.cameras.push_back(look_at("canopy", {26, 22, 46}, {-2, 5, -6}, 0.75F));

    auto flat =
        flatten_levels(scene, static_cast<std::uint32_t>(value("levels")), flat_triangles_max);
    if (!flat) return tl::unexpected<Error>(flat.error());
    if (wind != 0)
        scene.motion = blow(scene.objects[scene.root], static_cast<float>(wind),
                            static_cast<float>(value("seconds")), Random(value("seed") + 1));
    return scene;
}

}  // namespace raynest
