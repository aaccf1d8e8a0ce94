#include "engine/integrators/integrator.h"

#include "engine/geometry/tile_order.h"
#include "engine/integrators/target_module.h"
#include "integrator_headers.inc"

#include <array>
#include <cmath>
#include <numbers>

namespace raynest {
namespace {

constexpr std::array integrators = {
#define RAYNEST_INTEGRATOR(name, Type, lit, text, ...) \
    IntegratorInfo{#name, text, lit, {__VA_ARGS__}},
#include "engine/integrators/integrators.def"
};

}  // namespace

std::span<const IntegratorInfo> integrator_table() {
    return integrators;
}

std::string integrator_names() {
    std::string names;
    for (const IntegratorInfo& one : integrators)
        names.append(names.empty() ? "" : ", ").append(one.name);
    return names;
}

Result<std::unique_ptr<const Integrator>> make_from_list(std::string_view name,
                                                         const IntegratorScene& scene,
                                                         const IntegratorSettings& settings) {
#define RAYNEST_INTEGRATOR(id, Type, ...) \
    if (name == #id) return std::make_unique<const Type>(scene, settings);
#include "engine/integrators/integrators.def"
    return fail(ErrorCode::param_invalid,
                "unknown integrator '" + std::string(name) + "': use one of " + integrator_names());
}

bool Integrator::add(const SampleRange& range, RayCaster& caster, Wavefront& arrays,
                     Film& film) const {
    arrays.samples.assign(range.samples(), FilmSample{});
    if (!render(range, caster, arrays, arrays.samples)) return false;
    const ImageSize size = range.window.size_of(range.camera);
    const std::span<const FilmSample> samples(arrays.samples);
    for_each_in_tiles(range.first_pixel, range.pixel_count, size.width, size.height,
                      [&](std::uint64_t i, std::uint64_t x, std::uint64_t y) {
                          film.add(y * size.width + x, range.first_sample,
                                   samples.subspan(i * range.sample_count, range.sample_count));
                      });
    return true;
}

bool cast_camera_rays(const SampleRange& range, RayCaster& caster, Wavefront& arrays) {
    const ImageSize size = range.window.size_of(range.camera);
    const std::uint64_t row_pixels = ray_grid(range.camera).width;
    arrays.pixels.resize(range.pixel_count);
    arrays.rays.resize(range.samples());
    arrays.hits.resize(range.samples());
    const auto make = [&](const auto& sensor) {
        for_each_in_tiles(
            range.first_pixel, range.pixel_count, size.width, size.height,
            [&](std::uint64_t i, std::uint64_t column, std::uint64_t row) {
                const std::uint64_t x = range.window.x + column, y = range.window.y + row;
                arrays.pixels[i] = y * row_pixels + x;
                for (std::uint32_t s = 0; s < range.sample_count; ++s) {
                    Ray& ray = arrays.rays[i * range.sample_count + s];
                    if constexpr (requires { sensor.ray_at(0.5, 0.5); }) {
                        const Vec2 at =
                            Sampler(range.seed, arrays.pixels[i], range.first_sample + s)
                                .pair(pixel_dimension);
                        ray = sensor.ray_at(static_cast<double>(x) + static_cast<double>(at.x),
                                            static_cast<double>(y) + static_cast<double>(at.y));
                    } else {
                        ray = sensor.ray(x, y);
                    }
                }
            });
    };
    std::visit(make, range.camera);
    return caster.closest(std::span<const Ray>(arrays.rays), arrays.hits);
}

void describe_first_hit(const ColumnSource& scene, const Ray& ray, const HitRecord& hit,
                        FilmSample& sample) {
    if (hit.hit == 0) return;
    sample.alpha = 1;
    const Vec3 normal = world_normal(scene, ray, hit);
    sample.normal = glm::dot(normal, ray.direction) > 0 ? -normal : normal;
    sample.depth = hit.t;
    sample.position = point_along(ray.origin, ray.direction, hit.t);
    sample.instance = static_cast<std::uint32_t>(hit.path);
    sample.mesh = hit.object;
    const ObjectRecord& object = scene.scene->objects[hit.object];
    if (object.triangle_count != 0)
        sample.material = scene.scene->geometry_of(object, hit.triangle).material;
}

Vec3 cosine_direction(const Vec3& normal, const Vec2& random) {
    // A frame without branches (Duff et al., "Building an orthonormal basis, revisited", 2017).
    const float sign = std::copysign(1.0F, normal.z);
    const float a = -1 / (sign + normal.z);
    const float b = normal.x * normal.y * a;
    const Vec3 x(1 + sign * normal.x * normal.x * a, sign * b, -sign * normal.x);
    const Vec3 y(b, sign + normal.y * normal.y * a, -normal.y);
    const float radius = std::sqrt(random.x);
    const float angle = 2 * std::numbers::pi_v<float> * random.y;
    return radius * std::cos(angle) * x + radius * std::sin(angle) * y +
           std::sqrt(1 - random.x) * normal;
}

}  // namespace raynest
