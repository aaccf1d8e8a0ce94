#include "engine/integrators/path.h"

#include "engine/integrators/surface_point.h"
#include "engine/shading/materials.h"
#include "engine/shading/shading_point.h"

#include <algorithm>
#include <cmath>

namespace raynest {
namespace {

/// Dimensions of random numbers that one vertex takes.
enum Dimension : std::uint32_t { light_point, choices, scattered, roulette, dimensions_per_vertex };

/// Vertices that no path ends before.
constexpr std::uint32_t roulette_from = 3;
constexpr float roulette_most = 0.95F;

/// The cone of a camera ray as a share of its pixel. The samples of a pixel average textures by
/// themselves; a cone of the whole pixel would blur them a second time.
constexpr float cone_share = 0.25F;

/// How the cone of a camera ray widens: its width at the start, and per unit of t.
struct Cone {
    float width = 0, spread = 0;
};
Cone cone_of(const Sensor& sensor) {
    if (const auto* pinhole = std::get_if<Pinhole>(&sensor))
        return {0, cone_share * static_cast<float>(pinhole->step_y)};
    if (const auto* parallel = std::get_if<Orthographic>(&sensor))
        return {cone_share * static_cast<float>(parallel->height / parallel->size.height), 0};
    if (const auto* all_around = std::get_if<Equirectangular>(&sensor))
        return {0, cone_share * 2.0F * pi / static_cast<float>(all_around->rays().width)};
    return {};
}

/// The fields of describe_first_hit(), but the normal.
void describe_ids(const SceneView& scene, const Ray& ray, const HitRecord& hit,
                  FilmSample& sample) {
    sample.alpha = 1;
    sample.depth = hit.t;
    sample.position = point_along(ray.origin, ray.direction, hit.t);
    sample.instance = static_cast<std::uint32_t>(hit.path);
    sample.mesh = hit.object;
    const ObjectRecord& object = scene.objects[hit.object];
    if (object.triangle_count != 0)
        sample.material = scene.geometry_of(object, hit.triangle).material;
}

/// Share of light that is left after a way through a solid (Beer's law).
Vec3 absorbed(const SurfaceRecord& surface, float distance) {
    if (!(surface.attenuation_distance > 0)) return Vec3(1);
    const float part = distance / surface.attenuation_distance;
    const Vec3& c = surface.attenuation_colour;
    return {std::pow(c.x, part), std::pow(c.y, part), std::pow(c.z, part)};
}

}  // namespace

/// A path on its way: what it carries, and how its last direction was drawn.
struct Path::State {
    Vec3 throughput{1};
    Vec3 radiance{0};
    float density = 0;  ///< of the last direction; 0: no other strategy could have found it
    float width = 0, spread = 0;
    float covered = 0;  ///< FilmSample::alpha
};

/// Rays that a vertex adds to the wavefront: a ray that goes on, and one to a light.
struct Path::Step {
    Ray next, shadow;
    Vec3 light{0};  ///< what arrives if the shadow ray meets nothing
    bool goes_on = false;
    FilmSample* film = nullptr;  ///< of the first vertex
};

Path::Path(const IntegratorScene& scene, const IntegratorSettings& settings, std::uint32_t depth)
    : scene_(scene.source),
      view_(scene.shading != nullptr ? *scene.shading : ShadingView{scene.source.scene}),
      lighting_(scene, settings),
      depth_(depth) {}

bool Path::render(const SampleRange& range, RayCaster& caster, Wavefront& arrays,
                  std::span<FilmSample> out) const {
    if (!cast_camera_rays(range, caster, arrays)) return false;
    const Cone cone = cone_of(range.camera);
    std::vector<State> states(out.size());
    std::vector<std::uint32_t> active(out.size());
    std::vector<Vec3> light;
    std::vector<std::uint32_t> lit;
    PlacementCache placements;
    for (std::uint32_t i = 0; i < active.size(); ++i) {
        active[i] = i;
        states[i].width = cone.width;
        states[i].spread = cone.spread;
    }

    for (std::uint32_t bounce = 0; !active.empty(); ++bounce) {
        arrays.shadow_rays.clear();
        light.clear();
        lit.clear();
        std::size_t going = 0;
        for (std::size_t k = 0; k < active.size(); ++k) {
            const std::uint32_t i = active[k];
            State& state = states[i];
            if (arrays.hits[k].hit == 0) {
                leave(arrays.rays[k], bounce, state);
                continue;
            }
            Step step;
            step.film = bounce == 0 ? &out[i] : nullptr;
            shade(arrays.rays[k], arrays.hits[k], sampler_of(range, arrays, i), bounce, placements,
                  state, step);
            if (!is_black(step.light)) {
                arrays.shadow_rays.push_back(step.shadow);
                light.push_back(step.light);
                lit.push_back(i);
            }
            if (!step.goes_on) continue;
            active[going] = i;
            arrays.rays[going++] = step.next;
        }
        active.resize(going);

        arrays.occluded.resize(lit.size());
        if (!lit.empty() && !caster.occluded(arrays.shadow_rays, arrays.occluded)) return false;
        for (std::size_t k = 0; k < lit.size(); ++k)
            if (arrays.occluded[k] == 0) states[lit[k]].radiance += light[k];
        const std::span<const Ray> rays(arrays.rays.data(), going);
        if (going != 0 && !caster.closest(rays, std::span(arrays.hits).first(going))) return false;
    }

    for (std::size_t i = 0; i < out.size(); ++i) {
        const State& state = states[i];
        out[i].radiance = state.radiance;
        out[i].alpha = std::max(out[i].alpha, state.covered);
    }
    return true;
}

void Path::leave(const Ray& ray, std::uint32_t bounce, State& state) const {
    if (lighting_.empty()) return;
    const Vec3 direction = glm::normalize(ray.direction);
    const Vec3 radiance = lighting_.far_radiance(direction);
    if (is_black(radiance)) return;
    const float weight =
        state.density > 0 ? power_heuristic(state.density, lighting_.far_density(direction)) : 1.0F;
    state.radiance += state.throughput * radiance * weight;
    if (bounce == 0) state.covered = 1;
}

void Path::shade(const Ray& ray, const HitRecord& hit, const Sampler& sampler,
                 std::uint32_t bounce, PlacementCache& placements, State& state,
                 Step& step) const {
    const Placement& placement = placements.find(*view_.scene, hit.path);
    const SurfacePoint place = surface_point(scene_, ray, hit, placement);
    const float distance = hit.t * glm::length(ray.direction);
    state.width += state.spread * (bounce == 0 ? hit.t : distance);
    const ShadingPoint point =
        shading_point(view_, ray, hit, place.normal, state.width, placement);
    if (step.film != nullptr) {
        describe_ids(*view_.scene, ray, hit, *step.film);
        step.film->albedo = point.material.base_colour;
        step.film->normal = point.frame.z;
    }
    if (point.material.inside) state.throughput *= absorbed(*point.surface, distance);

    const auto draw = [&](Dimension dimension) {
        return sampler.pair(sampler_dimensions + bounce * dimensions_per_vertex + dimension);
    };
    const Vec3 outgoing = point.frame.to_local(-glm::normalize(ray.direction));
    with_material(point.kind, point.material, outgoing, [&](const auto& material) {
        const Vec3 emitted = material.emitted();
        if (!is_black(emitted)) {
            const float cosine = std::abs(glm::dot(point.normal, glm::normalize(ray.direction)));
            const float other =
                state.density > 0 ? lighting_.triangle_density(hit, distance, cosine) : 0.0F;
            const float weight = other > 0 ? power_heuristic(state.density, other) : 1.0F;
            state.radiance += state.throughput * emitted * weight;
        }
        if (bounce >= depth_ || !material.scatters()) return;

        // Reflected light leaves on the viewer's side, also where it grazes the triangle from below.
        const auto origin = [&](const Vec3& world, const Vec3& local) {
            return place.origin(local.z > 0 ? point.normal : world, point.shift(world, local));
        };
        const Vec2 choice = draw(choices);
        if (!lighting_.empty()) {
            const LightSample light =
                lighting_.sample(Vec3(place.position), choice.x, draw(light_point));
            const Vec3 incoming = point.frame.to_local(light.direction);
            if (light.density > 0 && !is_black(light.radiance) &&
                point.scatters(light.direction, incoming)) {
                const Vec3 scattered_light = material.evaluate(incoming);
                const float weight =
                    light.can_be_met ? power_heuristic(light.density, material.density(incoming))
                                     : 1.0F;
                step.light = state.throughput * scattered_light * light.radiance *
                             (weight / light.density);
                step.shadow.origin = origin(light.direction, incoming);
                step.shadow.direction =
                    light.ends ? Vec3(light.end - glm::dvec3(step.shadow.origin)) : light.direction;
                step.shadow.tmax = light.ends ? 1.0F : std::numeric_limits<float>::infinity();
            }
        }

        const Vec3 incoming = material.sample(choice.y, draw(scattered));
        if (incoming == Vec3(0)) return;
        const Vec3 direction = glm::normalize(point.frame.to_world(incoming));
        const float density = material.density(incoming);
        if (!(density > 0) || !point.scatters(direction, incoming)) return;
        state.throughput *= material.evaluate(incoming) / density;
        const float carried = largest(state.throughput);
        if (!(carried > 0)) return;
        if (bounce + 1 >= roulette_from) {
            const float survival = std::min(carried, roulette_most);
            if (draw(roulette).x >= survival) return;
            state.throughput /= survival;
        }
        state.density = density;
        state.spread = std::max(state.spread, std::min(0.125F / std::sqrt(density), 0.25F));
        step.next.origin = origin(direction, incoming);
        step.next.direction = direction;
        step.goes_on = true;
    });
}

}  // namespace raynest
