#include "tests/bench/generators.h"

#include "engine/assets/builtin/noise.h"
#include "engine/math/random.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <numbers>
#include <string_view>
#include <utility>

namespace raynest::bench {
namespace {

constexpr float tau = 2 * std::numbers::pi_v<float>;

std::uint32_t scaled(float full, float factor, std::uint32_t least) {
    return std::max(least, static_cast<std::uint32_t>(full * factor));
}

// ---- Shapes -------------------------------------------------------------------------------------

/// columns x rows quads of two triangles; at(s, t) is the point for s, t in [0, 1].
template <class Surface>
void add_surface(GeometryDescription& mesh, std::uint32_t columns, std::uint32_t rows,
                 Surface&& at) {
    const auto first = static_cast<std::uint32_t>(mesh.positions.size());
    for (std::uint32_t j = 0; j <= rows; ++j) {
        for (std::uint32_t i = 0; i <= columns; ++i) {
            mesh.positions.push_back(at(static_cast<float>(i) / static_cast<float>(columns),
                                        static_cast<float>(j) / static_cast<float>(rows)));
        }
    }
    for (std::uint32_t j = 0; j < rows; ++j) {
        for (std::uint32_t i = 0; i < columns; ++i) {
            const std::uint32_t a = first + j * (columns + 1) + i;
            const std::uint32_t b = a + columns + 1;
            for (const std::uint32_t corner : {a, b, a + 1, a + 1, b, b + 1}) {
                mesh.indices.push_back(corner);
            }
        }
    }
}

void add_ellipsoid(GeometryDescription& mesh, std::uint32_t columns, std::uint32_t rows,
                   const Vec3& centre, const Vec3& radii) {
    add_surface(mesh, columns, rows, [&](float s, float t) {
        const float ring = std::sin(0.5F * tau * t);
        return centre + radii * Vec3(ring * std::cos(tau * s), std::cos(0.5F * tau * t),
                                     ring * std::sin(tau * s));
    });
}

/// An open tube of `sides` sides along from -> to, thinner towards the end by `taper`.
void add_tube(GeometryDescription& mesh, std::uint32_t sides, std::uint32_t rows, const Vec3& from,
              const Vec3& to, float radius, float taper) {
    const Vec3 axis = to - from;
    const Vec3 helper = std::abs(axis.x) < std::abs(axis.y) ? Vec3(1, 0, 0) : Vec3(0, 1, 0);
    const Vec3 x = glm::normalize(glm::cross(helper, axis));
    const Vec3 y = glm::normalize(glm::cross(axis, x));
    add_surface(mesh, sides, rows, [&](float s, float t) {
        const float r = radius * (1 - taper * t);
        return from + t * axis + r * (std::cos(tau * s) * x + std::sin(tau * s) * y);
    });
}

/// A point in the unit ball, by rejection: no trigonometry.
Vec3 in_ball(Random& random) {
    for (;;) {
        const Vec3 p{random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1)};
        if (glm::dot(p, p) <= 1 && glm::dot(p, p) > 1e-4F) return p;
    }
}

/// A square of half side `half`, turned at random, with texture coordinates over the whole image.
void add_card(GeometryDescription& mesh, const Vec3& centre, float half, Random& random) {
    const Vec3 normal = glm::normalize(in_ball(random));
    const Vec3 x = half * glm::normalize(glm::cross(normal, in_ball(random)));
    const Vec3 y = glm::cross(normal, x);
    const auto first = static_cast<std::uint32_t>(mesh.positions.size());
    for (const Vec2 corner : {Vec2(-1, -1), Vec2(1, -1), Vec2(1, 1), Vec2(-1, 1)}) {
        mesh.positions.push_back(centre + corner.x * x + corner.y * y);
        mesh.texcoords[0].push_back(0.5F * corner + 0.5F);
    }
    for (const std::uint32_t i : {0U, 1U, 2U, 0U, 2U, 3U}) mesh.indices.push_back(first + i);
}

CameraDescription camera_at(const Vec3& eye, const Vec3& at, float yfov) {
    const Vec3 z = glm::normalize(eye - at);
    const Vec3 x = glm::normalize(glm::cross(Vec3(0, 1, 0), z));
    const Vec3 y = glm::cross(z, x);
    CameraDescription camera{"view", {}, yfov, 16.0F / 9};
    camera.to_world.m = {x.x, y.x, z.x, eye.x, x.y, y.y, z.y, eye.y, x.z, y.z, z.z, eye.z};
    return camera;
}

float ground_height(float x, float z, float relief) {
    const float n = fractal_noise(x * 0.02F + 300, z * 0.02F + 300, 6, 0, 5);
    return relief * n * n;
}

GeometryDescription ground(float extent, float relief, std::uint32_t cells) {
    GeometryDescription mesh;
    add_surface(mesh, cells, cells, [&](float s, float t) {
        const float x = extent * (s - 0.5F);
        const float z = extent * (t - 0.5F);
        return Vec3(x, ground_height(x, z, relief), z);
    });
    return mesh;
}

std::uint32_t add_object(SceneDescription& scene, std::string name, GeometryDescription mesh) {
    ObjectDescription object;
    object.name = std::move(name);
    object.geometries.push_back(std::move(mesh));
    scene.objects.push_back(std::move(object));
    return static_cast<std::uint32_t>(scene.objects.size() - 1);
}

/// Turned about the vertical, scaled alike in all directions.
Transform placement(const Vec3& at, float angle, float size) {
    const float c = size * std::cos(angle);
    const float s = size * std::sin(angle);
    Transform t;
    t.m = {c, 0, s, at.x, 0, size, 0, at.y, -s, 0, c, at.z};
    return t;
}

// ---- Scenes -------------------------------------------------------------------------------------

Generated terrain(float scale) {
    const float fineness = std::sqrt(scale);
    constexpr float extent = 100;
    constexpr float relief = 22;
    Random random(1);
    GeometryDescription spheres;
    for (int i = 0; i < 160; ++i) {
        const float x = random.uniform(-0.48F, 0.48F) * extent;
        const float z = random.uniform(-0.48F, 0.48F) * extent;
        const float radius = random.uniform(0.3F, 2.5F);
        add_ellipsoid(spheres, scaled(80, fineness, 8), scaled(40, fineness, 4),
                      {x, ground_height(x, z, relief) + 0.6F * radius, z}, Vec3(radius));
    }
    Generated out;
    add_object(out.scene, "terrain", ground(extent, relief, scaled(700, fineness, 8)));
    out.scene.objects[0].geometries.push_back(std::move(spheres));
    out.scene.cameras.push_back(camera_at({10, 30, 62}, {0, 4, 0}, 0.75F));
    return out;
}

Generated cards(float scale) {
    // The area of all cards, and with it the number of cards on a ray (about 14), stays the same.
    const float half = 0.012F / std::sqrt(scale);
    Random random(2);
    GeometryDescription mesh;
    const std::uint32_t count = scaled(200'000, scale, 100);
    for (std::uint32_t i = 0; i < count; ++i) {
        const Vec3 centre{random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1)};
        add_card(mesh, centre, half, random);
    }
    mesh.material = 0;

    Generated out;
    constexpr std::uint32_t side = 256;
    ImageDescription image{side, side, {}};
    for (std::uint32_t y = 0; y < side; ++y) {
        for (std::uint32_t x = 0; x < side; ++x) {
            const float n = fractal_noise(static_cast<float>(x) / 32, static_cast<float>(y) / 32, 3,
                                          side / 32, 7);
            image.rgba.insert(image.rgba.end(),
                              {90, 140, 60, n >= 0.5F ? std::uint8_t{255} : std::uint8_t{0}});
        }
    }
    out.scene.images.push_back(std::move(image));
    out.scene.textures.push_back({0, Wrap::repeat, Wrap::repeat, true});
    MaterialDescription material;
    material.name = "card";
    material.texture = 0;
    material.alpha_mode = AlphaMode::mask;
    material.double_sided = true;
    out.scene.materials.push_back(material);
    add_object(out.scene, "cards", std::move(mesh));
    out.scene.cameras.push_back(camera_at({1.6F, 1.2F, 3.2F}, {0, 0, 0}, 0.6F));
    return out;
}

/// About 1,000 triangles: a stem and leaves around the upper part of it.
GeometryDescription plant(Random& random, const Vec3& tip, float thickness, float reach) {
    GeometryDescription mesh;
    add_tube(mesh, 8, 4, {0, 0, 0}, tip, thickness, 0.8F);
    mesh.texcoords[0].resize(mesh.positions.size());
    for (int i = 0; i < 468; ++i) {
        add_card(mesh, 0.65F * tip + reach * in_ball(random), 0.05F * reach, random);
    }
    mesh.texcoords[0].clear();
    return mesh;
}

Generated forest1(float scale) {
    constexpr float extent = 400;
    constexpr float relief = 40;
    Random random(3);
    Generated out;
    for (int i = 0; i < 4; ++i) {
        add_object(out.scene, "tree", plant(random, {0, random.uniform(5, 8), 0}, 0.2F, 2));
    }
    out.scene.root =
        add_object(out.scene, "forest", ground(extent, relief, scaled(200, std::sqrt(scale), 8)));
    const std::uint32_t trees = scaled(10'000, scale, 16);
    for (std::uint32_t i = 0; i < trees; ++i) {
        const float x = random.uniform(-0.49F, 0.49F) * extent;
        const float z = random.uniform(-0.49F, 0.49F) * extent;
        const float angle = random.uniform(0, tau);
        InstanceDescription instance;
        instance.object = random.below(4);
        instance.transform =
            placement({x, ground_height(x, z, relief), z}, angle, random.uniform(0.7F, 1.4F));
        out.scene.objects[out.scene.root].instances.push_back(std::move(instance));
    }
    out.scene.cameras.push_back(camera_at({0, 60, 190}, {0, 10, 20}, 0.75F));
    return out;
}

/// Branches on trees, trees in stands, stands on the ground.
Generated forest3(float scale) {
    constexpr float extent = 400;
    constexpr float relief = 40;
    Random random(4);
    Generated out;
    SceneDescription& scene = out.scene;
    for (int i = 0; i < 4; ++i) {
        add_object(scene, "branch", plant(random, {1.5F, 0.8F, 0}, 0.03F, 0.8F));
    }
    const auto add_group = [&](const char* name, std::uint32_t count, std::uint32_t first_child,
                               auto&& place) {
        ObjectDescription group;
        group.name = name;
        for (std::uint32_t i = 0; i < count; ++i) {
            InstanceDescription instance;
            instance.object = first_child + random.below(4);
            instance.transform = place();
            group.instances.push_back(std::move(instance));
        }
        scene.objects.push_back(std::move(group));
        return static_cast<std::uint32_t>(scene.objects.size() - 1);
    };
    for (int i = 0; i < 4; ++i) {
        add_group("tree", 50, 0, [&] {
            const float height = random.uniform(1.5F, 8);
            const float angle = random.uniform(0, tau);
            return placement({0, height, 0}, angle, 1.3F - 0.12F * height);
        });
    }
    const std::uint32_t trees = scaled(100, std::sqrt(scale), 2);
    for (int i = 0; i < 4; ++i) {
        add_group("stand", trees, 4, [&] {
            const Vec3 at = 30.0F * in_ball(random);
            const float angle = random.uniform(0, tau);
            return placement({at.x, 0, at.z}, angle, random.uniform(0.8F, 1.3F));
        });
    }
    scene.root = add_group("forest", scaled(20, std::sqrt(scale), 2), 8, [&] {
        const float x = random.uniform(-0.42F, 0.42F) * extent;
        const float z = random.uniform(-0.42F, 0.42F) * extent;
        const float angle = random.uniform(0, tau);
        return placement({x, ground_height(x, z, relief), z}, angle, 1);
    });
    scene.objects[scene.root].geometries.push_back(
        ground(extent, relief, scaled(200, std::sqrt(scale), 8)));
    scene.cameras.push_back(camera_at({0, 60, 190}, {0, 10, 20}, 0.75F));
    return out;
}

/// Appends every placed mesh below `object` to the root, in the order of path ids.
void lift_leaves(const SceneDescription& scene, std::uint32_t object, const Transform& to_world,
                 std::vector<InstanceDescription>& leaves) {
    for (const InstanceDescription& instance : scene.objects[object].instances) {
        InstanceDescription leaf;
        leaf.object = instance.object;
        leaf.transform = compose(to_world, instance.transform);
        if (!scene.objects[instance.object].geometries.empty()) leaves.push_back(leaf);
        lift_leaves(scene, instance.object, leaf.transform, leaves);
    }
}

Generated forest3_flat(float scale) {
    Generated out = forest3(scale);
    std::vector<InstanceDescription> leaves;
    lift_leaves(out.scene, out.scene.root, Transform{}, leaves);
    for (ObjectDescription& object : out.scene.objects) object.instances.clear();
    out.scene.objects[out.scene.root].instances = std::move(leaves);
    return out;
}

Generated interior(float scale) {
    const float fineness = std::sqrt(scale);
    const Vec3 room(12, 4, 8);
    // Turned about two axes, so that no wall and no plank fits its box.
    const float cy = std::cos(0.6F), sy = std::sin(0.6F), cx = std::cos(0.35F),
                sx = std::sin(0.35F);
    const auto turned = [&](const Vec3& p) {
        const Vec3 q(cy * p.x + sy * p.z, p.y, cy * p.z - sy * p.x);
        return Vec3(q.x, cx * q.y - sx * q.z, sx * q.y + cx * q.z);
    };
    Random random(5);
    GeometryDescription mesh;
    // Six faces of planks, up to 15 cm wide and 3 m long.
    for (int axis = 0; axis < 3; ++axis) {
        for (const float side : {0.0F, 1.0F}) {
            add_surface(mesh, scaled(80, fineness, 8), 4, [&](float s, float t) {
                Vec3 p(0.0F);
                p[axis] = side;
                p[(axis + 1) % 3] = axis == 1 ? t : s;
                p[(axis + 2) % 3] = axis == 1 ? s : t;
                return p * room;
            });
        }
    }
    const std::uint32_t slats = scaled(200, scale, 10);
    for (std::uint32_t i = 0; i < slats; ++i) {  // a blind's, as high as the room
        const float x = room.x * (0.05F + 0.9F * static_cast<float>(i) / static_cast<float>(slats));
        add_surface(mesh, 1, 1, [&](float s, float t) {
            return Vec3(x + 0.012F * s, 0.1F + 3.6F * t, 0.3F + 0.01F * s);
        });
    }
    for (std::uint32_t i = 0; i < scaled(300, scale, 20); ++i) {  // wires across the room
        const Vec3 from = room * (0.5F + 0.48F * in_ball(random));
        const Vec3 to = glm::clamp(from + 3.0F * in_ball(random), 0.02F * room, 0.98F * room);
        add_tube(mesh, 6, 1, from, to, 0.003F, 0);
    }
    for (int i = 0; i < 42; ++i) {  // furniture: finely tessellated, tapering bodies
        const Vec3 radii{random.uniform(0.15F, 0.7F), random.uniform(0.2F, 1.2F),
                         random.uniform(0.15F, 0.7F)};
        const float x = random.uniform(0.08F, 0.92F) * room.x;
        const float z = random.uniform(0.15F, 0.92F) * room.z;
        add_ellipsoid(mesh, scaled(240, fineness, 8), scaled(120, fineness, 4), {x, radii.y, z},
                      radii);
    }
    for (Vec3& p : mesh.positions) p = turned(p);

    Generated out;
    add_object(out.scene, "room", std::move(mesh));
    out.scene.cameras.push_back(camera_at(turned(room * Vec3(0.06F, 0.6F, 0.92F)),
                                          turned(room * Vec3(0.6F, 0.25F, 0.3F)), 1.0F));
    const Vec3 corner = turned(room * Vec3(0.35F, 0.99F, 0.35F));
    out.light = Light{corner,
                      {turned(room * Vec3(0.65F, 0.99F, 0.35F)) - corner,
                       turned(room * Vec3(0.35F, 0.99F, 0.65F)) - corner}};
    return out;
}

constexpr std::pair<std::string_view, Generated (*)(float)> scenes[] = {
    {"terrain", terrain}, {"cards", cards},       {"forest1", forest1},
    {"forest3", forest3}, {"interior", interior}, {"forest3-flat", forest3_flat}};

}  // namespace

Result<Generated> generate(const std::string& source) {
    std::string_view rest = source;
    rest.remove_prefix(std::min(rest.size(), std::string_view("gen:").size()));
    const std::string_view name = rest.substr(0, rest.find('?'));
    rest.remove_prefix(std::min(rest.size(), name.size() + 1));
    float scale = 1;
    if (!rest.empty()) {
        constexpr std::string_view key = "scale=";
        const bool named = rest.starts_with(key);
        rest.remove_prefix(named ? key.size() : 0);
        const auto [end, error] = std::from_chars(rest.data(), rest.data() + rest.size(), scale);
        const bool whole = error == std::errc{} && end == rest.data() + rest.size();
        if (!named || !whole || !(scale > 0 && scale <= 4)) {
            return fail(ErrorCode::param_invalid,
                        source + ": a generated scene takes scale=S with S in (0, 4]");
        }
    }
    std::string known;
    for (const auto& [scene_name, describe] : scenes) {
        if (scene_name == name) return describe(scale);
        known += (known.empty() ? "" : ", ") + std::string(scene_name);
    }
    return fail(ErrorCode::param_invalid,
                "there is no generated scene '" + std::string(name) + "'; there are " + known);
}

}  // namespace raynest::bench
