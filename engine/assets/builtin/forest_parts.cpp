// Trees, bushes, ferns, grass, stones and the floor, as objects of triangles and instances.
#include "engine/assets/builtin/forest_parts.h"

#include "engine/assets/builtin/noise.h"

#include <algorithm>

namespace raynest::forest {
namespace {

Vec3 any_normal(const Vec3& v) {
    const Vec3 help = std::abs(v.y) < 0.9F ? Vec3(0, 1, 0) : Vec3(1, 0, 0);
    return glm::normalize(glm::cross(help, v));
}

Vec3 on_sphere(Random& random) {
    const float y = random.uniform(-1, 1);
    const float angle = random.uniform(0, 2 * pi);
    const float r = std::sqrt(std::max(0.0F, 1 - y * y));
    return {r * std::cos(angle), y, r * std::sin(angle)};
}

GeometryDescription& geometry_for(ObjectDescription& object, MaterialId material) {
    for (GeometryDescription& geometry : object.geometries) {
        if (geometry.material == material) return geometry;
    }
    GeometryDescription& geometry = object.geometries.emplace_back();
    geometry.material = material;
    return geometry;
}

std::uint32_t add_vertex(GeometryDescription& geometry, const Vec3& position, const Vec2& uv) {
    geometry.positions.push_back(position);
    geometry.texcoords[0].push_back(uv);
    return static_cast<std::uint32_t>(geometry.positions.size() - 1);
}

void add_quad(GeometryDescription& geometry, std::uint32_t a, std::uint32_t b, std::uint32_t c,
              std::uint32_t d) {
    for (const std::uint32_t corner : {a, b, c, a, c, d}) geometry.indices.push_back(corner);
}

/// Adds a card standing on `base`, growing along `up`, with the part [u0, u1] x [v0, v1] of its
/// texture (v down).
void add_card(GeometryDescription& geometry, const Vec3& base, const Vec3& up,
              const Vec3& half_side, const Vec2& uv_low, const Vec2& uv_high) {
    const std::uint32_t a = add_vertex(geometry, base - half_side, {uv_low.x, uv_high.y});
    const std::uint32_t b = add_vertex(geometry, base + half_side, {uv_high.x, uv_high.y});
    const std::uint32_t c = add_vertex(geometry, base + half_side + up, {uv_high.x, uv_low.y});
    const std::uint32_t d = add_vertex(geometry, base - half_side + up, {uv_low.x, uv_low.y});
    add_quad(geometry, a, b, c, d);
}

struct Ring {
    Vec3 center;
    float radius;
};

/// Adds a tapered tube through the rings; bark repeats once per metre along it.
void add_tube(GeometryDescription& geometry, const std::vector<Ring>& rings, std::uint32_t sides) {
    float along = 0;
    std::uint32_t previous = 0;
    for (std::size_t i = 0; i < rings.size(); ++i) {
        const std::size_t next = std::min(i + 1, rings.size() - 1);
        const std::size_t last = i == 0 ? 0 : i - 1;
        const Vec3 axis = glm::normalize(rings[next].center - rings[last].center);
        const Vec3 x = any_normal(axis);
        const Vec3 z = glm::cross(axis, x);
        if (i != 0) along += glm::length(rings[i].center - rings[i - 1].center);
        const auto first = static_cast<std::uint32_t>(geometry.positions.size());
        for (std::uint32_t s = 0; s <= sides; ++s) {
            const float share = static_cast<float>(s) / static_cast<float>(sides);
            const float angle = 2 * pi * share;
            add_vertex(
                geometry,
                rings[i].center + rings[i].radius * (std::cos(angle) * x + std::sin(angle) * z),
                {share * 2, along});
        }
        for (std::uint32_t s = 0; i != 0 && s < sides; ++s) {
            add_quad(geometry, previous + s, previous + s + 1, first + s + 1, first + s);
        }
        previous = first;
    }
}

}  // namespace

Transform place(const Vec3& position, float scale, float turn, float tilt) {
    const float c = std::cos(turn);
    const float s = std::sin(turn);
    const float ct = std::cos(tilt);
    const float st = std::sin(tilt);
    Transform t;
    t.m = {scale * c * ct, scale * c * -st, scale * s,      position.x, scale * st, scale * ct, 0,
           position.y,     scale * -s * ct, scale * s * st, scale * c,  position.z};
    return t;
}

ObjectDescription leaf_cluster(Random random, std::uint32_t cards, MaterialId material) {
    ObjectDescription object;
    object.name = "leaves";
    GeometryDescription& geometry = geometry_for(object, material);
    for (std::uint32_t i = 0; i < cards; ++i) {
        // Cards point outwards and a little up, and mostly face the sky.
        const Vec3 out = glm::normalize(on_sphere(random) + Vec3(0, 0.35F, 0));
        const Vec3 side = glm::normalize(glm::cross(out, on_sphere(random) + Vec3(0, 0.6F, 0.01F)));
        const float size = random.uniform(0.42F, 0.62F);
        const std::uint32_t cell = random.below(4);
        const Vec2 low(0.5F * static_cast<float>(cell % 2), 0.5F * static_cast<float>(cell / 2));
        add_card(geometry, out * random.uniform(0.0F, 0.16F), out * size, side * (size * 0.5F), low,
                 low + 0.5F);
    }
    return object;
}

ObjectDescription needle_bough(Random random) {
    ObjectDescription object;
    object.name = "bough";
    GeometryDescription& geometry = geometry_for(object, needles);
    // The flat spray is two drooping halves, and two shorter ones that hang from it.
    const auto spray = [&](const Vec3& base, const Vec3& along, const Vec3& side, float length) {
        const Vec3 bend = along * (0.5F * length) - Vec3(0, 0.06F * length, 0);
        add_card(geometry, base, bend, side * (0.3F * length), {0, 0.5F}, {1, 1});
        add_card(geometry, base + bend, along * (0.5F * length) - Vec3(0, 0.2F * length, 0),
                 side * (0.3F * length), {0, 0}, {1, 0.5F});
    };
    spray(Vec3(0), {1, 0, 0}, {0, 0, 1}, 1);
    for (const float turn : {-0.5F, 0.5F}) {
        const Vec3 along = glm::normalize(Vec3(1, random.uniform(-0.5F, -0.2F), turn));
        const Vec3 side = glm::normalize(glm::cross(along, Vec3(0, 1, 0)) + Vec3(0, turn, 0));
        spray({random.uniform(0.1F, 0.3F), -0.02F, 0}, along, side, random.uniform(0.6F, 0.75F));
    }
    return object;
}

ObjectDescription fern_plant(Random random) {
    ObjectDescription object;
    object.name = "fern";
    GeometryDescription& geometry = geometry_for(object, fern);
    constexpr int fronds = 9;
    constexpr int segments = 4;
    for (int i = 0; i < fronds; ++i) {
        const float turn = (static_cast<float>(i) + random.uniform(-0.3F, 0.3F)) * 2 * pi / fronds;
        const Vec3 out(std::cos(turn), 0, std::sin(turn));
        const Vec3 side = Vec3(-out.z, random.uniform(-0.2F, 0.2F), out.x) * 0.13F;
        const float length = random.uniform(0.6F, 0.9F) / segments;
        Vec3 at = out * 0.03F;
        float pitch = random.uniform(1.0F, 1.3F);
        for (int k = 0; k < segments; ++k) {
            const Vec3 step = length * (std::cos(pitch) * out + Vec3(0, std::sin(pitch), 0));
            const float v = 1 - static_cast<float>(k) / segments;
            add_card(geometry, at, step, side, {0, v - 1.0F / segments}, {1, v});
            at += step;
            pitch -= random.uniform(0.4F, 0.55F);
        }
    }
    return object;
}

ObjectDescription grass_tuft(Random random) {
    ObjectDescription object;
    object.name = "grass";
    GeometryDescription& geometry = geometry_for(object, grass);
    for (int i = 0; i < 6; ++i) {
        const float turn = random.uniform(0, 2 * pi);
        const Vec3 side(std::cos(turn), 0, std::sin(turn));
        const Vec3 up = Vec3(0, random.uniform(0.25F, 0.42F), 0) + 0.08F * on_sphere(random);
        const Vec3 base(random.uniform(-0.2F, 0.2F), -0.01F, random.uniform(-0.2F, 0.2F));
        add_card(geometry, base, up, side * 0.2F, {0, 0}, {1, 1});
    }
    return object;
}

ObjectDescription boulder(std::uint64_t seed) {
    ObjectDescription object;
    object.name = "boulder";
    GeometryDescription& geometry = geometry_for(object, rock);
    constexpr std::uint32_t around = 20;
    constexpr std::uint32_t up = 12;
    for (std::uint32_t j = 0; j <= up; ++j) {
        for (std::uint32_t i = 0; i <= around; ++i) {
            const float a = 2 * pi * static_cast<float>(i % around) / around;
            const float b = pi * static_cast<float>(j) / up;
            const Vec3 n(std::sin(b) * std::cos(a), std::cos(b), std::sin(b) * std::sin(a));
            const float bump =
                fractal_noise(3 + 1.6F * n.x + n.y, 3 + 1.6F * n.z - n.y, 4, 0, seed);
            add_vertex(geometry, n * Vec3(0.6F, 0.42F, 0.5F) * (0.6F + 0.8F * bump), {});
        }
    }
    for (std::uint32_t j = 0; j < up; ++j) {
        for (std::uint32_t i = 0; i < around; ++i) {
            const std::uint32_t a = j * (around + 1) + i;
            add_quad(geometry, a, a + 1, a + around + 2, a + around + 1);
        }
    }
    return object;
}

ObjectDescription broadleaf(Random random, const BroadleafShape& shape,
                            const std::vector<std::uint32_t>& clusters) {
    ObjectDescription object;
    object.name = "tree";
    GeometryDescription& wood = geometry_for(object, shape.bark);
    struct Limb {
        Vec3 start;
        Vec3 direction;
        float length;
        float radius;
        int order;
    };
    std::vector<Limb> limbs{
        {Vec3(0, -0.5F, 0), Vec3(0, 1, 0), shape.height * 0.92F + 0.5F, shape.trunk_radius, 0}};
    const auto add_leaves = [&](const Vec3& at) {
        // Lighter cards go to the top, where the light comes from.
        const float up = at.y / shape.height + random.uniform(-0.28F, 0.28F);
        const auto tone = static_cast<std::size_t>(std::clamp(up, 0.0F, 0.999F) *
                                                   static_cast<float>(clusters.size()));
        object.instances.push_back({clusters[tone],
                                    place(at, shape.cluster_scale * random.uniform(0.8F, 1.3F),
                                          random.uniform(0, 2 * pi), random.uniform(-0.5F, 0.5F)),
                                    0xFFFFFFFFU,
                                    static_cast<std::uint32_t>(object.instances.size()), "leaves"});
    };

    for (std::size_t i = 0; i < limbs.size(); ++i) {
        const Limb limb = limbs[i];
        const bool trunk = limb.order == 0;
        const int segments = trunk ? 9 : limb.order == 1 ? 5 : 3;
        std::vector<Ring> rings;
        Vec3 at = limb.start;
        Vec3 direction = limb.direction;
        for (int k = 0; k <= segments; ++k) {
            const float s = static_cast<float>(k) / static_cast<float>(segments);
            const float flare = trunk ? 0.9F * std::exp(-14 * s) : 0;
            rings.push_back({at, limb.radius * (1 - 0.85F * s + flare)});
            at += direction * (limb.length / static_cast<float>(segments));
            direction = glm::normalize(direction + (trunk ? 0.07F : 0.2F) * on_sphere(random) +
                                       Vec3(0, trunk ? 0.1F : 0.16F * shape.rise, 0));
        }
        add_tube(wood, rings, trunk ? 12 : limb.order == 1 ? 6 : 4);

        const auto along = [&](float s) {
            const float x = s * static_cast<float>(segments);
            const auto k = std::min(static_cast<std::size_t>(x), rings.size() - 2);
            return glm::mix(rings[k].center, rings[k + 1].center, x - static_cast<float>(k));
        };
        if (limb.order < 2) {
            const std::uint32_t count = trunk ? shape.limbs : 4;
            const float first = trunk ? shape.crown_start : 0.3F;
            float turn = random.uniform(0, 2 * pi);
            for (std::uint32_t c = 0; c < count; ++c) {
                const float share = (static_cast<float>(c) + random.uniform(0.1F, 0.9F)) /
                                    static_cast<float>(count);
                const float s = first + (0.97F - first) * share;
                turn +=
                    2.4F + random.uniform(-0.3F, 0.3F);  // the golden angle spreads limbs evenly
                Vec3 out;
                float length = 0;
                if (trunk) {
                    const float up = shape.rise * (0.35F + 0.9F * share);
                    out = glm::normalize(Vec3(std::cos(turn), up, std::sin(turn)));
                    // An egg-shaped crown has its longest limbs a third of the way up.
                    length = shape.height * shape.spread * std::sin(pi * (0.22F + 0.68F * share)) *
                             random.uniform(0.85F, 1.1F);
                } else {
                    const Vec3 x = any_normal(limb.direction);
                    const Vec3 z = glm::cross(limb.direction, x);
                    out = glm::normalize(limb.direction +
                                         0.9F * (std::cos(turn) * x + std::sin(turn) * z));
                    length = limb.length * random.uniform(0.4F, 0.6F);
                }
                limbs.push_back(
                    {along(s), out, length, limb.radius * (1 - 0.8F * s) * 0.6F, limb.order + 1});
            }
        }
        // Leaves grow on the outer part of each limb, but not on the trunk.
        if (trunk) {
            add_leaves(rings.back().center);
            continue;
        }
        const float spacing = 0.52F * shape.cluster_scale;
        const auto count = static_cast<int>(limb.length * 0.7F / spacing) + 1;
        for (int k = 0; k < count; ++k) {
            const float s = 0.3F + 0.7F * (static_cast<float>(k) + 1) / static_cast<float>(count);
            add_leaves(along(s) + 0.18F * on_sphere(random));
        }
    }
    return object;
}

ObjectDescription spruce(Random random, float height, const std::vector<std::uint32_t>& boughs) {
    ObjectDescription object;
    object.name = "spruce";
    std::vector<Ring> rings;
    for (int k = 0; k <= 8; ++k) {
        const float s = static_cast<float>(k) / 8;
        const float radius = 0.018F * height * (1 - 0.97F * s) + 0.12F * std::exp(-16 * s);
        rings.push_back({{0, height * s - 0.4F, 0}, radius});
    }
    add_tube(geometry_for(object, bark), rings, 9);
    float turn = 0;
    for (float y = 0.9F; y < height - 0.3F; y += 0.46F + 0.16F * (1 - y / height)) {
        const float reach = 0.23F * height * std::pow(1 - y / height, 0.8F) + 0.15F;
        const int count = 5 + static_cast<int>(reach);
        for (int i = 0; i < count; ++i) {
            turn += 2 * pi / static_cast<float>(count) + random.uniform(-0.15F, 0.15F);
            // Low boughs hang; high boughs point up.
            const float tilt = -0.32F + 0.75F * (y / height) + random.uniform(-0.12F, 0.12F);
            object.instances.push_back(
                {boughs[random.below(static_cast<std::uint32_t>(boughs.size()))],
                 place({0, y + random.uniform(-0.12F, 0.12F), 0},
                       reach * random.uniform(0.85F, 1.15F), turn, tilt),
                 0xFFFFFFFFU, static_cast<std::uint32_t>(object.instances.size()), "bough"});
        }
        turn += 0.7F;
    }
    return object;
}

float floor_height(float x, float z) {
    const float hills = fractal_noise(x * 0.02F + 40, z * 0.02F + 40, 2, 0, 11);
    const float bumps = fractal_noise(x * 0.35F + 70, z * 0.35F + 70, 3, 0, 12);
    return 3.2F * (hills - 0.5F) + 0.22F * (bumps - 0.5F);
}

ObjectDescription floor_mesh(float radius) {
    ObjectDescription object;
    object.name = "floor";
    GeometryDescription& geometry = geometry_for(object, ground);
    constexpr std::uint32_t rings = 120;
    constexpr std::uint32_t sides = 120;
    for (std::uint32_t j = 0; j <= rings; ++j) {
        const float share = static_cast<float>(j) / rings;
        const float r = radius * share * share;
        for (std::uint32_t i = 0; i <= sides; ++i) {
            const float angle = 2 * pi * static_cast<float>(i % sides) / sides;
            const float x = r * std::cos(angle);
            const float z = r * std::sin(angle);
            add_vertex(geometry, {x, floor_height(x, z), z}, {x * 0.4F, z * 0.4F});
        }
    }
    for (std::uint32_t j = 0; j < rings; ++j) {
        for (std::uint32_t i = 0; i < sides; ++i) {
            const std::uint32_t a = j * (sides + 1) + i;
            add_quad(geometry, a, a + 1, a + sides + 2, a + sides + 1);
        }
    }
    return object;
}

}  // namespace raynest::forest
