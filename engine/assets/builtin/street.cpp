// builtin:street: a street of houses with cars, for sensors and for what moves.
//
//   scene -> car (body) -> wheel
//         -> house, tree, lamp, ground
//
// The street runs along X, two lanes a side of Z = 0. A car looks along its own +X and turns its
// wheels about their own Z. Instances are "car-0", "car-1", ..., each with "wheel-0" to "wheel-3";
// "house-*", "tree-*", "lamp-*". With `seconds` it has an animation: cars drive, with the first
// camera among them, and trees sway. Wheels stand still: they lie within the cars.
#include "engine/assets/builtin/builtin.h"
#include "engine/assets/builtin/look_at.h"
#include "engine/assets/builtin/play.h"
#include "engine/math/random.h"

#include <fmt/format.h>

#include <array>
#include <cmath>
#include <numbers>

namespace raynest {
namespace {

constexpr float pi = std::numbers::pi_v<float>;
constexpr float lane_width = 3.25F;
constexpr float kerb = 2 * lane_width + 0.5F;  ///< where the pavement begins, from the middle
constexpr float front = kerb + 3.5F;           ///< where the houses begin
constexpr float wheel_radius = 0.33F;
constexpr std::uint32_t house_variants = 6;
constexpr std::array<const char*, 6> paints{"red", "blue", "white", "black", "green", "silver"};

enum Material : std::uint32_t {
    asphalt,
    paving,
    marking,
    plaster,
    brick,
    sandstone,
    roof,
    window,
    rubber,
    steel,
    bark,
    leaves,
    paint
};

void add_material(SceneDescription& scene, const char* name, const Vec3& colour,
                  float roughness = 1, float metallic = 0) {
    MaterialDescription& material = scene.materials.emplace_back();
    material.name = name;
    material.base_colour = Vec4(colour, 1);
    material.surface.roughness = roughness;
    material.surface.metallic = metallic;
}

/// Adds a quadrilateral, anticlockwise as seen from its front.
void add_quad(GeometryDescription& mesh, const Vec3& a, const Vec3& b, const Vec3& c,
              const Vec3& d) {
    const auto first = static_cast<std::uint32_t>(mesh.positions.size());
    mesh.positions.insert(mesh.positions.end(), {a, b, c, d});
    mesh.indices.insert(mesh.indices.end(),
                        {first, first + 1, first + 2, first, first + 2, first + 3});
}

/// Adds a box whose top may be smaller than its bottom: by `taper` metres at -X, +X, and both sides
/// of Z.
void add_block(GeometryDescription& mesh, const Vec3& low, const Vec3& high,
               const Vec3& taper = Vec3(0)) {
    const auto corner = [&](int x, int y, int z) {
        Vec3 p(x == 0 ? low.x : high.x, y == 0 ? low.y : high.y, z == 0 ? low.z : high.z);
        if (y == 1) p += Vec3(x == 0 ? taper.x : -taper.y, 0, z == 0 ? taper.z : -taper.z);
        return p;
    };
    add_quad(mesh, corner(0, 0, 1), corner(1, 0, 1), corner(1, 1, 1), corner(0, 1, 1));
    add_quad(mesh, corner(1, 0, 0), corner(0, 0, 0), corner(0, 1, 0), corner(1, 1, 0));
    add_quad(mesh, corner(1, 0, 1), corner(1, 0, 0), corner(1, 1, 0), corner(1, 1, 1));
    add_quad(mesh, corner(0, 0, 0), corner(0, 0, 1), corner(0, 1, 1), corner(0, 1, 0));
    add_quad(mesh, corner(0, 1, 1), corner(1, 1, 1), corner(1, 1, 0), corner(0, 1, 0));
    add_quad(mesh, corner(0, 0, 0), corner(1, 0, 0), corner(1, 0, 1), corner(0, 0, 1));
}

/// Adds a closed cylinder or cone from `from` to `to`.
void add_rod(GeometryDescription& mesh, const Vec3& from, const Vec3& to, float radius,
             float radius_at_end, std::uint32_t sides) {
    const Vec3 axis = glm::normalize(to - from);
    const Vec3 u =
        glm::normalize(glm::cross(axis, std::abs(axis.y) < 0.9F ? Vec3(0, 1, 0) : Vec3(1, 0, 0)));
    const Vec3 v = glm::cross(axis, u);
    const auto rim = [&](const Vec3& centre, float r, std::uint32_t i) {
        const float angle = 2 * pi * static_cast<float>(i) / static_cast<float>(sides);
        return centre + r * (std::cos(angle) * u + std::sin(angle) * v);
    };
    for (std::uint32_t i = 0; i < sides; ++i) {
        add_quad(mesh, rim(from, radius, i), rim(from, radius, i + 1),
                 rim(to, radius_at_end, i + 1), rim(to, radius_at_end, i));
        add_quad(mesh, from, from, rim(from, radius, i + 1), rim(from, radius, i));
        add_quad(mesh, to, to, rim(to, radius_at_end, i), rim(to, radius_at_end, i + 1));
    }
}

ObjectDescription ground(float length) {
    ObjectDescription object;
    object.name = "ground";
    const float x = length / 2;
    GeometryDescription road, pavement, lines;
    road.material = asphalt;
    pavement.material = paving;
    lines.material = marking;
    add_quad(road, {-x, 0, kerb}, {x, 0, kerb}, {x, 0, -kerb}, {-x, 0, -kerb});
    for (const float side : {-1.0F, 1.0F}) {
        const float inner = side * kerb, outer = side * (front + 30);
        add_block(pavement, {-x, -0.2F, std::min(inner, outer)},
                  {x, 0.12F, std::max(inner, outer)});
        for (float at = -x + 2; at + 3 < x; at += 9) {
            const float z = side * lane_width;
            add_quad(lines, {at, 0.006F, z + 0.06F}, {at + 3, 0.006F, z + 0.06F},
                     {at + 3, 0.006F, z - 0.06F}, {at, 0.006F, z - 0.06F});
        }
    }
    add_quad(lines, {-x, 0.006F, 0.08F}, {x, 0.006F, 0.08F}, {x, 0.006F, -0.08F},
             {-x, 0.006F, -0.08F});
    object.geometries = {std::move(road), std::move(pavement), std::move(lines)};
    return object;
}

/// A house whose front is in the plane Z = 0 and looks along +Z, `width` wide.
ObjectDescription house(Random& random, std::uint32_t variant, float width) {
    ObjectDescription object;
    object.name = "house";
    const std::uint32_t floors = 3 + random.below(4);
    const float storey = random.uniform(2.9F, 3.5F);
    const float height = storey * static_cast<float>(floors) + 0.6F;
    const float depth = random.uniform(10, 14);
    GeometryDescription walls, panes, top;
    walls.material = plaster + variant % 3;
    panes.material = window;
    top.material = roof;
    add_block(walls, {-width / 2, 0, -depth}, {width / 2, height, 0});
    add_block(top, {-width / 2 - 0.2F, height, -depth - 0.2F},
              {width / 2 + 0.2F, height + random.uniform(1.5F, 4), 0.2F}, {0, 0, depth / 2 - 0.5F});
    const auto columns = static_cast<std::uint32_t>(width / 2.4F);
    for (std::uint32_t level = 0; level < floors; ++level)
        for (std::uint32_t column = 0; column < columns; ++column) {
            const float x =
                width * ((static_cast<float>(column) + 0.5F) / static_cast<float>(columns) - 0.5F);
            const float y = storey * static_cast<float>(level) + 0.95F;
            add_block(panes, {x - 0.55F, y, -0.1F}, {x + 0.55F, y + 1.5F, 0.03F});
            add_block(walls, {x - 0.7F, y - 0.12F, -0.1F}, {x + 0.7F, y, 0.16F});
        }
    object.geometries = {std::move(walls), std::move(panes), std::move(top)};
    return object;
}

ObjectDescription wheel() {
    ObjectDescription object;
    object.name = "wheel";
    GeometryDescription tyre, rim;
    tyre.material = rubber;
    rim.material = steel;
    add_rod(tyre, {0, 0, -0.11F}, {0, 0, 0.11F}, wheel_radius, wheel_radius, 24);
    // Five spokes on both sides show that it turns.
    for (const float side : {-1.0F, 1.0F})
        for (std::uint32_t i = 0; i < 5; ++i) {
            const float angle = 2 * pi * static_cast<float>(i) / 5;
            const Vec3 out(std::cos(angle), std::sin(angle), 0);
            const Vec3 off(0, 0, side * 0.12F);
            add_rod(rim, off + 0.04F * out, off + 0.24F * out, 0.035F, 0.025F, 6);
        }
    object.geometries = {std::move(tyre), std::move(rim)};
    return object;
}

ObjectDescription car(std::uint32_t colour, std::uint32_t wheel_object) {
    ObjectDescription object;
    object.name = "car";
    GeometryDescription body, glass, rest;
    body.material = paint + colour;
    glass.material = window;
    rest.material = rubber;
    add_block(body, {-2.15F, 0.28F, -0.88F}, {2.15F, 0.62F, 0.88F});
    add_block(body, {-2.15F, 0.62F, -0.88F}, {2.15F, 0.92F, 0.88F}, {0.06F, 0.25F, 0.06F});
    add_block(glass, {-1.75F, 0.9F, -0.8F}, {1.05F, 1.38F, 0.8F}, {0.5F, 0.75F, 0.14F});
    add_block(body, {-1.27F, 1.37F, -0.67F}, {0.32F, 1.44F, 0.67F}, {0.1F, 0.1F, 0.08F});
    add_block(rest, {-2.05F, 0.18F, -0.82F}, {2.05F, 0.29F, 0.82F});
    object.geometries = {std::move(body), std::move(glass), std::move(rest)};
    std::uint32_t number = 0;
    for (const float x : {1.35F, -1.35F})
        for (const float z : {0.78F, -0.78F}) {
            Transform at;
            at.m = {1, 0, 0, x, 0, 1, 0, wheel_radius, 0, 0, 1, z};
            object.instances.push_back(
                {wheel_object, at, 0xFFFFFFFFU, number, fmt::format("wheel-{}", number)});
            ++number;
        }
    return object;
}

ObjectDescription tree(Random random) {
    ObjectDescription object;
    object.name = "tree";
    GeometryDescription trunk, crown;
    trunk.material = bark;
    crown.material = leaves;
    add_rod(trunk, {0, 0, 0}, {0, 3.2F, 0}, 0.16F, 0.1F, 8);
    // Leaves are small quads in a ball.
    for (std::uint32_t i = 0; i < 700; ++i) {
        const float z = random.uniform(-1, 1), angle = random.uniform(0, 2 * pi);
        const float r = std::sqrt(1 - z * z);
        const Vec3 out(r * std::cos(angle), z, r * std::sin(angle));
        const Vec3 at = Vec3(0, 4.6F, 0) + out * (2.1F * std::cbrt(random.uniform(0.15F, 1)));
        const Vec3 u =
            glm::normalize(glm::cross(out, Vec3{random.uniform(-1, 1), 2, random.uniform(-1, 1)})) *
            0.17F;
        const Vec3 v = glm::normalize(glm::cross(out, u)) * 0.12F;
        add_quad(crown, at - u - v, at + u - v, at + u + v, at - u + v);
    }
    object.geometries = {std::move(trunk), std::move(crown)};
    return object;
}

ObjectDescription lamp() {
    ObjectDescription object;
    object.name = "lamp";
    GeometryDescription post;
    post.material = steel;
    add_rod(post, {0, 0, 0}, {0, 6, 0}, 0.09F, 0.05F, 10);
    add_rod(post, {0, 6, 0}, {0, 6.2F, 1.8F}, 0.05F, 0.04F, 8);
    add_block(post, {-0.15F, 6.1F, 1.6F}, {0.15F, 6.25F, 2.3F});
    object.geometries = {std::move(post)};
    return object;
}

/// Returns a placement turned about +Y: by half a turn, or not.
Transform stand(float x, float y, float z, bool turned) {
    const float s = turned ? -1.0F : 1.0F;
    Transform at;
    at.m = {s, 0, 0, x, 0, 1, 0, y, 0, 0, s, z};
    return at;
}

class Street {
public:
    Street(SceneDescription& scene, float length, std::uint64_t seed, float seconds)
        : scene_(scene),
          length_(length),
          seconds_(seconds),
          random_(seed) {
        root_.name = "street";
    }

    void build(std::uint32_t cars) {
        add(add_object(ground(length_)), Transform{}, "ground");
        build_houses();
        const std::uint32_t trees[] = {add_object(tree(random_.split())),
                                       add_object(tree(random_.split()))};
        const std::uint32_t post = add_object(lamp());
        for (const bool far_side : {false, true}) {
            const float side = far_side ? -1.0F : 1.0F;
            for (float x = -length_ / 2 + 6; x < length_ / 2 - 3; x += 18) {
                add(post, stand(x, 0.12F, side * (kerb + 0.5F), !far_side),
                    fmt::format("lamp-{}", lamps_++));
                add(trees[random_.below(2)],
                    stand(x + 9, 0.12F, side * (kerb + 1.2F), random_.below(2) == 0),
                    fmt::format("tree-{}", trees_++));
            }
        }
        park_cars(cars);
        scene_.objects.push_back(std::move(root_));
        scene_.root = static_cast<std::uint32_t>(scene_.objects.size() - 1);
    }
    /// Makes the animation of what moves, which is built.
    void play() {
        Play play(seconds_);
        // Its own: without an animation the street is the same.
        Random random = random_.split();
        const std::vector<InstanceDescription>& placed = scene_.objects[scene_.root].instances;
        for (std::uint32_t i = 0; i < placed.size(); ++i) {
            const Transform& at = placed[i].transform;
            if (placed[i].name.starts_with("car-"))
                play.follow(play.add_drive({at.m[0] * random.uniform(9, 14) * seconds_, 0, 0}), i,
                            at);
            if (placed[i].name.starts_with("tree-"))
                play.follow(play.add_sway({at.m[3], at.m[7], at.m[11]}, {1, 0, 0},
                                          random.uniform(0.02F, 0.06F), random.uniform(2, 4),
                                          random.uniform(0, 1)),
                            i, at);
        }
        const std::uint32_t driver = play.add_drive({11 * seconds_, 0, 0});
        play.follow_with_camera(driver, 0, scene_.cameras[0].to_world);
        scene_.motion = play.bytes();
    }

private:
    std::uint32_t add_object(ObjectDescription object) {
        scene_.objects.push_back(std::move(object));
        return static_cast<std::uint32_t>(scene_.objects.size() - 1);
    }
    void add(std::uint32_t object, const Transform& at, std::string name) {
        const auto uid = static_cast<std::uint32_t>(root_.instances.size());
        root_.instances.push_back({object, at, 0xFFFFFFFFU, uid, std::move(name)});
    }
    void build_houses() {
        std::array<std::uint32_t, house_variants> houses{};
        std::array<float, house_variants> widths{};
        for (std::uint32_t i = 0; i < house_variants; ++i) {
            widths[i] = random_.uniform(9, 16);
            houses[i] = add_object(house(random_, i, widths[i]));
        }
        std::uint32_t number = 0;
        for (const bool far_side : {false, true})
            for (float x = -length_ / 2; x < length_ / 2;) {
                const std::uint32_t variant = random_.below(house_variants);
                add(houses[variant],
                    stand(x + widths[variant] / 2, 0.12F, far_side ? -front : front, !far_side),
                    fmt::format("house-{}", number++));
                x += widths[variant] + (random_.below(5) == 0 ? 6.0F : 0.0F);
            }
    }
    /// Puts cars on the four lanes, at even distances with some jitter; traffic keeps to the right.
    void park_cars(std::uint32_t count) {
        const std::uint32_t turning = add_object(wheel());
        std::vector<std::uint32_t> models;
        for (std::uint32_t i = 0; i < paints.size(); ++i)
            models.push_back(add_object(car(i, turning)));
        const std::uint32_t rows = (count + 3) / 4;
        for (std::uint32_t i = 0; i < count; ++i) {
            const std::uint32_t lane = i % 4;
            const float step = length_ / static_cast<float>(std::max(rows, 1U));
            const float x =
                -length_ / 2 + step * (static_cast<float>(i / 4) + random_.uniform(0.3F, 0.7F));
            const float z = lane_width * (static_cast<float>(lane) - 1.5F);
            add(models[random_.below(static_cast<std::uint32_t>(models.size()))],
                stand(x, 0, z, lane < 2), fmt::format("car-{}", i));
        }
    }

    SceneDescription& scene_;
    const float length_;
    const float seconds_;
    Random random_;
    ObjectDescription root_;
    std::uint32_t lamps_ = 0, trees_ = 0;
};

}  // namespace

Result<SceneDescription> describe_street(const BuiltinValues& values) {
    SceneDescription scene;
    add_material(scene, "asphalt", {0.055F, 0.055F, 0.06F}, 0.9F);
    add_material(scene, "paving", {0.32F, 0.31F, 0.29F});
    add_material(scene, "marking", {0.75F, 0.75F, 0.72F});
    add_material(scene, "plaster", {0.72F, 0.66F, 0.53F});
    add_material(scene, "brick", {0.36F, 0.14F, 0.09F});
    add_material(scene, "sandstone", {0.55F, 0.45F, 0.34F});
    add_material(scene, "roof", {0.2F, 0.09F, 0.07F});
    add_material(scene, "window", {0.05F, 0.07F, 0.09F}, 0.08F);
    add_material(scene, "rubber", {0.02F, 0.02F, 0.02F}, 0.8F);
    add_material(scene, "steel", {0.5F, 0.5F, 0.52F}, 0.35F, 1);
    add_material(scene, "bark", {0.16F, 0.11F, 0.07F});
    add_material(scene, "leaves", {0.1F, 0.24F, 0.06F});
    scene.materials.back().double_sided = true;
    constexpr std::array<Vec3, paints.size()> colours{
        Vec3(0.5F, 0.03F, 0.03F),   Vec3(0.04F, 0.1F, 0.42F), Vec3(0.78F, 0.78F, 0.76F),
        Vec3(0.02F, 0.02F, 0.025F), Vec3(0.05F, 0.22F, 0.1F), Vec3(0.42F, 0.43F, 0.45F)};
    for (std::size_t i = 0; i < paints.size(); ++i)
        add_material(scene, paints[i], colours[i], 0.25F);
    const auto length = static_cast<float>(values.find("length")->second);
    const auto seconds = static_cast<float>(values.find("seconds")->second);
    Street street(scene, length, values.find("seed")->second, seconds);
    street.build(static_cast<std::uint32_t>(values.find("cars")->second));
    scene.cameras.push_back(look_at("driver", {-length / 2 + 6, 2.4F, 0}, {0, 1.4F, 0}, 0.9F));
    scene.cameras.push_back(
        look_at("roof", {-length / 2 + 5, 9, 8.5F}, {-length / 2 + 60, 0, -4}, 0.8F));
    if (seconds > 0) street.play();
    return scene;
}

}  // namespace raynest
