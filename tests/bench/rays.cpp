#include "tests/bench/rays.h"

#include "engine/integrators/generators.h"
#include "engine/queries/columns.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <string_view>
#include <utility>

namespace raynest::bench {
namespace {

constexpr std::uint32_t run_length = 1024;
constexpr std::uint32_t tile_rays = 64;

constexpr std::array<std::pair<std::string_view, RayKind>, 5> kinds{{{"primary", RayKind::primary},
                                                                     {"ao", RayKind::ao},
                                                                     {"shadow", RayKind::shadow},
                                                                     {"diffuse", RayKind::diffuse},
                                                                     {"random", RayKind::random}}};

/// Every run starts on a tile.
std::vector<Ray> sample_runs(std::vector<Ray> rays, std::uint32_t count) {
    if (rays.size() <= count) return rays;
    const std::uint32_t runs = std::max(1U, count / run_length);
    const std::size_t length = count / runs;
    const std::size_t stride = rays.size() / runs / tile_rays * tile_rays;
    std::vector<Ray> sample;
    sample.reserve(runs * length);
    for (std::size_t run = 0; run < runs; ++run) {
        const auto first = rays.begin() + static_cast<std::ptrdiff_t>(run * stride);
        sample.insert(sample.end(), first, first + static_cast<std::ptrdiff_t>(length));
    }
    return sample;
}

/// 64 rays in a row are a square of 8 x 8 pixels, 16 one of 4 x 4: what packets of either width
/// like best.
std::vector<Ray> picture_rays(const Snapshot& scene, std::uint32_t pixels) {
    const auto camera = choose_camera(scene, {});
    const auto height = std::max(
        8U, static_cast<std::uint32_t>(std::sqrt(static_cast<float>(pixels) * 9 / 16) / 8) * 8);
    const std::uint32_t width = std::max(8U, pixels / height / 8 * 8);
    std::vector<Ray> tiles(std::size_t{width} * height);
    generate_tiles(pinhole(*camera, {width, height}), 0, tiles);
    for (Ray& ray : tiles) ray.direction = glm::normalize(ray.direction);
    return tiles;
}

struct Point {
    Vec3 position;  ///< a little off the surface, on the side that the primary ray came from
    Vec3 normal;
};

std::vector<Point> visible_points(const SceneView& scene, std::span<const Ray> rays, float offset,
                                  TraceFunction trace) {
    std::vector<HitRecord> hits(rays.size());
    const auto count = static_cast<std::uint32_t>(rays.size());
    const TraceCall call{&scene, nullptr,     rays.data(), count,   1,      0xFFFFFFFFU,
                         0,      hits.data(), nullptr,     nullptr, nullptr};
    trace(&call);
    ColumnSource source;
    source.scene = &scene;
    std::vector<Point> points;
    for (std::uint32_t i = 0; i < count; ++i) {
        if (hits[i].hit == 0) continue;
        Vec3 normal = world_normal(source, rays[i], hits[i]);
        if (glm::dot(normal, rays[i].direction) > 0) normal = -normal;
        if (!(glm::length(normal) > 0.5F)) continue;
        points.push_back(
            {rays[i].origin + hits[i].t * rays[i].direction + offset * normal, normal});
    }
    return points;
}

/// A direction around n with density cos / pi (Malley's method).
Vec3 cosine_direction(const Vec3& n, Random& random) {
    const float r = std::sqrt(random.uniform());
    const float phi = 2 * std::numbers::pi_v<float> * random.uniform();
    const Vec3 helper = std::abs(n.x) < 0.5F ? Vec3(1, 0, 0) : Vec3(0, 1, 0);
    const Vec3 x = glm::normalize(glm::cross(helper, n));
    const Vec3 y = glm::cross(n, x);
    return glm::normalize(r * std::cos(phi) * x + r * std::sin(phi) * y +
                          std::sqrt(std::max(0.0F, 1 - r * r)) * n);
}

Light light_above(const Box& box) {
    const Vec3 size = box.size();
    const Vec3 corner = box.lower + size * Vec3(0.25F, 1.5F, 0.25F);
    return {corner, {{0.5F * size.x, 0, 0}, {0, 0, 0.5F * size.z}}};
}

/// Ends just before the light, so that no surface behind or at it counts.
Ray shadow_ray(const Point& from, const Light& light, Random& random) {
    const Vec2 at{random.uniform(), random.uniform()};
    const Vec3 way = light.corner + at.x * light.edge[0] + at.y * light.edge[1] - from.position;
    return {from.position, 0, glm::normalize(way), 0.999F * glm::length(way)};
}

}  // namespace

Result<RayKind> parse_ray_kind(const std::string& name) {
    std::string known;
    for (const auto& [kind_name, kind] : kinds) {
        if (kind_name == name) return kind;
        known += (known.empty() ? "" : ", ") + std::string(kind_name);
    }
    return fail(ErrorCode::param_invalid,
                "unknown ray kind '" + name + "': use " + known + " or a .rays file");
}

Query natural_query(RayKind kind) {
    return kind == RayKind::ao || kind == RayKind::shadow ? query_any : query_closest;
}

std::vector<Ray> make_rays(const Workload& workload, RayKind kind, std::uint32_t count,
                           TraceFunction trace) {
    Random random(17);
    const Box& box = workload.scene->bounds();
    if (kind == RayKind::random) return random_rays(box, count, random);
    std::vector<Ray> picture = picture_rays(*workload.scene, 8 * count);
    if (kind == RayKind::primary) return sample_runs(std::move(picture), count);

    const float reach = glm::length(box.size());
    const Light light = workload.light.value_or(light_above(box));
    std::vector<Ray> rays;
    for (const Point& point :
         visible_points(workload.scene->view(), picture, 1e-4F * reach, trace)) {
        if (kind == RayKind::shadow) {
            rays.push_back(shadow_ray(point, light, random));
            continue;
        }
        Ray& ray = rays.emplace_back();
        ray.origin = point.position;
        ray.direction = cosine_direction(point.normal, random);
        if (kind == RayKind::ao) ray.tmax = 0.05F * reach;
    }
    return sample_runs(std::move(rays), count);
}

std::vector<Ray> random_rays(const Box& box, std::uint32_t count, Random& random) {
    std::vector<Ray> rays(count);
    for (Ray& ray : rays) {
        for (int axis = 0; axis < 3; ++axis) {
            ray.origin[axis] = random.uniform(box.lower[axis], box.upper[axis]);
        }
        do {
            for (int axis = 0; axis < 3; ++axis) ray.direction[axis] = random.uniform(-1, 1);
        } while (glm::length(ray.direction) > 1 || glm::length(ray.direction) < 0.01F);
        ray.direction = glm::normalize(ray.direction);
    }
    return rays;
}

}  // namespace raynest::bench
