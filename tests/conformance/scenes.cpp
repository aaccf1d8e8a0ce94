#include "tests/conformance/scenes.h"

#include "engine/geometry/sphere_shape.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace raynest::conformance {
namespace {

constexpr float scene_half = 4.0F;

Transform random_transform(Random& random, float spread, bool gentle) {
    const Vec3 axis = random.direction();
    const float angle = random.between(0, 6.28F);
    const float c = std::cos(angle);
    const float s = std::sin(angle);
    Transform t;
    for (int row = 0; row < 3; ++row) {
        for (int column = 0; column < 3; ++column) {
            const float cross = row == column                 ? 0.0F
                                : (column - row + 3) % 3 == 1 ? -axis[3 - row - column]
                                                              : axis[3 - row - column];
            const float scale = gentle ? 1.0F : (column == 0 ? 1.4F : column == 1 ? 0.8F : 1.0F);
            const float mirror = !gentle && column == 2 ? -1.0F : 1.0F;
            t.m[static_cast<std::size_t>(4 * row + column)] =
                ((row == column ? c : 0.0F) + (1 - c) * axis[row] * axis[column] + s * cross) *
                scale * mirror;
        }
        t.m[static_cast<std::size_t>(4 * row + 3)] = random.between(-spread, spread);
    }
    if (!gentle) t.m[1] += 0.2F;  // a shear
    return t;
}

// A 16 x 16 picture whose alpha has soft and hard edges.
ImageDescription mask_image() {
    ImageDescription image{16, 16, {}};
    for (std::uint32_t y = 0; y < 16; ++y) {
        for (std::uint32_t x = 0; x < 16; ++x) {
            const auto alpha = static_cast<std::uint8_t>((x / 4 + y / 4) % 2 == 0 ? 255 : 16 * x);
            image.rgba.insert(image.rgba.end(), {static_cast<std::uint8_t>(16 * x),
                                                 static_cast<std::uint8_t>(16 * y), 128, alpha});
        }
    }
    return image;
}

void add_materials(SceneDescription& scene) {
    scene.images.push_back(mask_image());
    scene.textures.push_back({0, Wrap::repeat, Wrap::mirror, false});
    scene.textures.push_back({0, Wrap::clamp, Wrap::repeat, true});
    const auto add = [&](const char* name, AlphaMode mode, std::uint32_t texture, float factor,
                         bool double_sided) {
        MaterialDescription material;
        material.name = name;
        material.alpha_mode = mode;
        material.texture = texture;
        material.base_colour.w = factor;
        material.double_sided = double_sided;
        material.uv_transform = {1.5F, 0.25F, 0.1F, -0.25F, 1.5F, 0.2F};
        scene.materials.push_back(std::move(material));
    };
    add("plain", AlphaMode::opaque, no_id, 1, false);
    add("leaves", AlphaMode::mask, 0, 1, true);
    add("fence", AlphaMode::mask, 1, 0.9F, false);
    add("glass", AlphaMode::blend, 0, 0.8F, true);
}

GeometryDescription random_geometry(std::uint32_t triangles, std::uint32_t material, float half,
                                    Random& random) {
    GeometryDescription g;
    g.material = material;
    for (std::uint32_t i = 0; i < 3 * triangles; ++i) {
        const Vec3 center =
            i % 3 == 0 ? random.in_box(half) : g.positions[i - i % 3] + 0.6F * random.direction();
        g.positions.push_back(center);
        g.texcoords[0].emplace_back(random.between(-2, 3), random.between(-2, 3));
        g.indices.push_back(i);
        for (int c = 0; c < 4; ++c) {
            g.colours.push_back(static_cast<std::uint8_t>(200 + random.below(56)));
        }
    }
    return g;
}

// Zero area, needles, coincident copies, flat in one axis, tiny: never hit, or hit with ties.
GeometryDescription awkward_geometry(float half, Random& random) {
    GeometryDescription g;
    g.material = 0;
    const auto add = [&](const Vec3& a, const Vec3& b, const Vec3& c) {
        for (const Vec3& v : {a, b, c}) {
            g.indices.push_back(static_cast<std::uint32_t>(g.positions.size()));
            g.positions.push_back(v);
        }
    };
    const Vec3 p = random.in_box(half);
    add(p, p, p);
    add(p, p + Vec3(1, 0, 0), p + Vec3(2, 0, 0));
    add(p, p + Vec3(1e4F, 0, 0), p + Vec3(0, 1e-4F, 0));
    for (int copy = 0; copy < 20; ++copy) {
        add(p + Vec3(0, 0, 1), p + Vec3(1, 0, 1), p + Vec3(0, 1, 1));
    }
    for (int i = 0; i < 6; ++i) {
        const Vec3 q = random.in_box(half);
        add(Vec3(q.x, 0, q.z), Vec3(q.x + 1, 0, q.z), Vec3(q.x, 0, q.z + 1));
    }
    const Vec3 q = random.in_box(half);
    add(q, q + Vec3(1e-20F, 0, 0), q + Vec3(0, 1e-20F, 0));
    return g;
}

ObjectDescription sphere_object(std::uint32_t count, Random& random) {
    ObjectDescription object;
    object.name = "spheres";
    object.record_type = "sphere";
    for (std::uint32_t i = 0; i < count; ++i) {
        const Vec3 c = random.in_box(scene_half);
        const float radius = i == 0 ? 0.0F : random.between(0.05F, 0.5F);
        const Sphere sphere{c, radius};
        const auto* bytes = reinterpret_cast<const std::byte*>(&sphere);
        object.records.insert(object.records.end(), bytes, bytes + sizeof sphere);
        object.record_bounds.push_back(bounds(sphere));
    }
    return object;
}

}  // namespace

Vec3 Random::direction() {
    for (;;) {
        const Vec3 v = in_box(1);
        const float length = glm::length(v);
        if (length > 0.1F && length <= 1) return v / length;
    }
}

SceneDescription nested_scene(std::uint32_t depth, std::uint64_t seed) {
    Random random(seed + depth);
    SceneDescription scene;
    add_materials(scene);
    // Deep chains have one instance per level; shallow scenes branch.
    const bool chain = depth > 5;
    for (std::uint32_t level = 0; level < depth; ++level) {  // innermost first
        ObjectDescription object;
        object.name = "level-" + std::to_string(depth - level);
        for (std::uint32_t material = 0; material < 4; ++material) {
            object.geometries.push_back(
                random_geometry(chain ? 3 : 12, material, scene_half, random));
        }
        if (level == 0) {
            object.geometries.push_back(awkward_geometry(scene_half, random));
            object.geometries.back().material = no_id;
        }
        if (level > 0) {
            const std::uint32_t copies = chain ? 1 : 3;
            for (std::uint32_t i = 0; i < copies; ++i) {
                InstanceDescription instance;
                instance.object = level - 1;
                instance.transform =
                    random_transform(random, chain ? 0.3F : scene_half, chain || i == 0);
                instance.uid = 100 * level + i;
                object.instances.push_back(instance);
            }
            if (level == 1) {  // spheres have an object of their own, beside the triangles
                InstanceDescription spheres;
                spheres.object = depth;
                spheres.transform = random_transform(random, 1.0F, false);
                object.instances.push_back(spheres);
            }
            InstanceDescription hidden = object.instances.back();
            hidden.mask = 0;
            object.instances.push_back(hidden);
            InstanceDescription flat = object.instances.front();
            for (const std::size_t i : {1U, 5U, 9U}) flat.transform.m[i] = 0;  // y collapses
            object.instances.push_back(flat);
        }
        scene.objects.push_back(std::move(object));
    }
    scene.root = depth - 1;
    if (depth > 1) scene.objects.push_back(sphere_object(12, random));
    return scene;
}

SceneDescription crowded_scene(std::uint64_t seed, BuildQuality build) {
    Random random(seed);
    SceneDescription scene;
    scene.build = build;
    add_materials(scene);
    GeometryDescription cube;  // from -1 to 1
    for (std::uint32_t corner = 0; corner < 8; ++corner) {
        const auto side = [&](std::uint32_t axis) {
            return (corner >> axis & 1U) != 0 ? 1.0F : -1.0F;
        };
        cube.positions.emplace_back(side(0), side(1), side(2));
    }
    cube.indices = {0, 2, 1, 1, 2, 3, 4, 5, 6, 5, 7, 6, 0, 1, 4, 1, 5, 4,
                    2, 6, 3, 3, 6, 7, 0, 4, 2, 2, 4, 6, 1, 3, 5, 3, 7, 5};
    scene.objects.resize(2);
    scene.objects[0].name = "cube";
    scene.objects[0].geometries.push_back(std::move(cube));
    ObjectDescription& root = scene.objects[1];
    root.name = "root";
    root.geometries.push_back(random_geometry(12, 0, scene_half, random));
    const auto place = [&](Transform transform, const Vec3& at) {
        for (std::size_t row = 0; row < 3; ++row)
            transform.m[4 * row + 3] = at[static_cast<int>(row)];
        InstanceDescription instance;
        instance.object = 0;
        instance.transform = transform;
        if (random.below(8) == 0) instance.mask = 1U << random.below(8);
        root.instances.push_back(instance);
    };
    for (std::uint32_t i = 0; i < 27; ++i) {
        const Vec3 cell(i % 3, i / 3 % 3, i / 9);
        const Vec3 at = 2.0F * cell - 2.0F;
        place(Transform{}, at);
        place(Transform{{-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0}}, at);
        place(Transform{{0, 1, 0, 0, 0, 0, 1, 0, 1, 0, 0, 0}}, at);
        if (random.below(3) == 0) place(Transform{{1, 0.5F, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0}}, at);
    }
    place(Transform{{3, 0, 0, 0, 0, 3, 0, 0, 0, 0, 3, 0}}, Vec3(0));
    scene.root = 1;
    return scene;
}

SceneDescription sphere_scene(std::uint64_t seed) {
    Random random(seed);
    SceneDescription scene;
    scene.objects.push_back(sphere_object(60, random));
    return scene;
}

SceneDescription needles(std::uint32_t count, std::uint64_t seed) {
    Random random(seed);
    GeometryDescription geometry;
    for (std::uint32_t i = 0; i < count; ++i) {
        const Vec3 at = random.in_box(6);
        const Vec3 along = random.direction() * random.between(0.5F, 8);
        const float ratio = std::pow(10.0F, -3 * random.unit());
        const Vec3 across = random.direction() * ratio * glm::length(along);
        for (const Vec3& p : {at, at + along, at + random.unit() * along + across}) {
            geometry.indices.push_back(static_cast<std::uint32_t>(geometry.positions.size()));
            geometry.positions.push_back(p);
        }
    }
    SceneDescription scene;
    scene.objects.resize(1);
    scene.objects[0].geometries.push_back(std::move(geometry));
    return scene;
}

SceneDescription sheet_scene(std::uint32_t triangles, std::uint32_t depth, std::uint64_t seed) {
    Random random(seed);
    SceneDescription scene;
    const auto side = static_cast<std::uint32_t>(std::sqrt(static_cast<float>(triangles) / 2));
    GeometryDescription g;
    for (std::uint32_t y = 0; y <= side; ++y) {
        for (std::uint32_t x = 0; x <= side; ++x) {
            const float fx = 4 * static_cast<float>(x) / static_cast<float>(side) - 2;
            const float fy = 4 * static_cast<float>(y) / static_cast<float>(side) - 2;
            g.positions.emplace_back(fx, fy, 0.7F * std::sin(2 * fx) + 0.1F * random.unit());
        }
    }
    for (std::uint32_t y = 0; y < side; ++y) {
        for (std::uint32_t x = 0; x < side; ++x) {
            const std::uint32_t i = y * (side + 1) + x;
            g.indices.insert(g.indices.end(),
                             {i, i + 1, i + side + 1, i + side + 1, i + 1, i + side + 2});
        }
    }
    scene.objects.emplace_back();
    scene.objects.back().name = "sheet";
    scene.objects.back().geometries.push_back(std::move(g));
    for (std::uint32_t level = 1; level < depth; ++level) {
        ObjectDescription object;
        object.name = "turn-" + std::to_string(level);
        for (int i = 0; i < 2; ++i) {
            InstanceDescription instance;
            instance.object = level - 1;
            instance.transform = random_transform(random, 1.0F, i == 0);
            object.instances.push_back(instance);
        }
        scene.objects.push_back(std::move(object));
    }
    scene.root = depth - 1;
    return scene;
}

std::array<Vec3, 3> random_triangle(const SceneDescription& scene, Random& random) {
    // Walk down to a random triangle, then apply the chain of transforms back up.
    std::vector<const Transform*> chain;
    const ObjectDescription* object = &scene.objects[scene.root];
    for (;;) {
        const bool go_down =
            !object->instances.empty() && (object->geometries.empty() || random.below(3) != 0);
        if (!go_down) break;
        const auto& instance =
            object->instances[random.below(static_cast<std::uint32_t>(object->instances.size()))];
        if (!scene.objects[instance.object].records.empty()) continue;  // spheres have no edges
        chain.push_back(&instance.transform);
        object = &scene.objects[instance.object];
    }
    const auto& g =
        object->geometries[random.below(static_cast<std::uint32_t>(object->geometries.size()))];
    const std::uint32_t triangle = random.below(static_cast<std::uint32_t>(g.indices.size() / 3));
    const std::uint32_t first = random.below(3);
    std::array<Vec3, 3> corners;
    for (std::uint32_t k = 0; k < 3; ++k) {
        Vec3 p = g.positions[g.indices[3 * triangle + (first + k) % 3]];
        for (auto it = chain.rbegin(); it != chain.rend(); ++it) p = (*it)->point(p);
        corners[k] = p;
    }
    return corners;
}

Vec3 random_edge_point(const SceneDescription& scene, Random& random) {
    const auto [a, b, c] = random_triangle(scene, random);
    return random.below(4) == 0 ? a : a + random.unit() * (b - a);
}

std::vector<Ray> random_rays(std::uint32_t count, float half, Random& random) {
    std::vector<Ray> rays(count);
    for (Ray& ray : rays) {
        ray.origin = random.in_box(half);
        ray.direction = random.direction() * random.between(0.1F, 5.0F);
        if (random.below(4) == 0) {
            ray.tmin = random.between(0, 2);
            ray.tmax = ray.tmin + random.between(0, 4);
        }
    }
    return rays;
}

std::vector<Ray> edge_rays(const SceneDescription& scene, std::uint32_t count, float half,
                           Random& random) {
    std::vector<Ray> rays(count);
    for (Ray& ray : rays) {
        const Vec3 target = random_edge_point(scene, random);
        ray.origin =
            random.below(3) == 0 ? target + 0.5F * random.direction() : random.in_box(half);
        if (random.below(4) == 0) {  // along an axis, to touch planes of boxes
            const int axis = static_cast<int>(random.below(3));
            ray.origin = target;
            ray.origin[axis] += random.below(2) == 0 ? half : -half;
        }
        ray.direction = target - ray.origin;
    }
    return rays;
}

std::vector<Ray> pinhole_rays(const SceneDescription& scene, std::uint32_t count, Random& random) {
    constexpr std::uint32_t packet = 64;
    const auto power = [&](float least, float most) {
        return std::pow(10.0F, random.between(least, most));
    };
    std::vector<Ray> rays;
    while (rays.size() < count) {
        const auto [a, b, c] = random_triangle(scene, random);
        const float size = std::max({glm::length(b - a), glm::length(c - b), glm::length(a - c)});
        Vec3 from = random.direction();
        if (random.below(4) == 0) {  // two equal components, or only one non-zero
            const int axis = static_cast<int>(random.below(3));
            from = Vec3(0);
            from[axis] = 1;
            if (random.below(2) == 0) from[(axis + 1) % 3] = -1;
        }
        const Vec3 eye = a + size * power(0.5F, 4) * from;
        const float scatter = random.below(2) == 0 ? 0 : size * power(-7, 0);
        const bool mixed = random.below(8) == 0;
        for (std::uint32_t i = 0; i < packet; ++i) {
            const Vec3 on_edge = random.below(8) == 0 ? a : a + random.unit() * (b - a);
            const Vec3 target =
                random.below(4) == 0 ? on_edge + random.unit() * (c - on_edge) : on_edge;
            Ray& ray = rays.emplace_back();
            ray.origin = eye;
            ray.direction = (target + scatter * random.direction()) - eye;
            if (!mixed) continue;
            switch (random.below(8)) {
                case 0:
                    ray.direction = random.direction();
                    break;
                case 1:
                    ray.tmax = random.between(0, 2);
                    break;
                case 2:
                    ray.tmin = -1;
                    break;
                default:
                    break;
            }
        }
    }
    return rays;
}

std::vector<Ray> odd_rays(std::uint32_t count, float half, Random& random) {
    constexpr float inf = std::numeric_limits<float>::infinity();
    constexpr float nan = std::numeric_limits<float>::quiet_NaN();
    std::vector<Ray> rays;
    while (rays.size() < count) {
        Ray ray;
        ray.origin = random.in_box(half);
        ray.direction = random.direction();
        const int axis = static_cast<int>(random.below(3));
        switch (random.below(16)) {
            case 0:
                ray.direction = Vec3(0);
                break;
            case 1:
                ray.direction[axis] = nan;
                break;
            case 2:
                ray.origin[axis] = inf;
                break;
            case 3:
                ray.tmin = 2, ray.tmax = 1;
                break;
            case 4:
                ray.tmin = -1;
                break;
            case 5:
                ray.tmax = nan;
                break;
            case 6:
                ray.direction = Vec3(0), ray.direction[axis] = 1;
                break;
            case 7:
                ray.direction = Vec3(-0.0F), ray.direction[axis] = -1;
                break;
            case 8:
                ray.direction *= 1e-30F;
                break;
            case 9:
                ray.direction *= 1e30F;
                break;
            case 10:
                ray.origin *= 1e6F, ray.direction = -ray.origin;
                break;
            case 11:
                ray.origin *= 1e30F, ray.direction = -random.direction();
                break;
            case 12:
                ray.direction[axis] = 1e-40F;
                break;
            case 13:
                ray.tmin = ray.tmax = 1;
                break;
            case 14:
                ray.origin = Vec3(0), ray.direction = Vec3(1, 1, 1);
                break;
            default:
                ray.origin[axis] = 0, ray.direction[axis] = 0;
                break;
        }
        rays.push_back(ray);
    }
    return rays;
}

}  // namespace raynest::conformance
