#include "engine/integrators/path.h"

#include "engine/integrators/surface_point.h"
#include "engine/shading/materials.h"
#include "engine/shading/placement.h"
#include "engine/shading/shading_point.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <numeric>

namespace raynest {
namespace {

/// Dimensions of random numbers that one vertex takes.
enum Dimension : std::uint32_t { light_point, choices, scattered, roulette, dimensions_per_vertex };

Vec2 draw(const Sampler& sampler, std::uint32_t bounce, Dimension dimension) {
    return sampler.pair(sampler_dimensions + bounce * dimensions_per_vertex + dimension);
}

/// Vertices that no path ends before.
constexpr std::uint32_t roulette_from = 3;
constexpr float roulette_most = 0.95F;

/// The cone of a camera ray as a share of its pixel. The samples of a pixel average textures by
/// themselves; a cone of the whole pixel would blur them a second time.
constexpr float cone_share = 0.25F;

/// A direction that was drawn with at least this density per solid angle comes from a mirror or a
/// clear pane, in which a viewer sees what lights nothing.
constexpr float mirror_density = 100;

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
    float density = 0;  ///< the last direction's; 0: no other strategy could have found it
    float width = 0, spread = 0;
    float covered = 0;  ///< FilmSample::alpha
};

/// A hit on a path, and the rays that it adds to the wavefront: one that goes on, and one to a
/// light.
struct Path::Vertex {
    std::uint32_t path;  ///< number of the sample
    std::uint32_t ray;   ///< number of the ray that came here, and of its hit
    float distance;
    SurfacePoint place;
    UnfinishedPoint point;
    Vec2 choice, light_point;  ///< random numbers, if it draws a light

    Ray next, shadow;
    Vec3 light{0};  ///< what arrives if the shadow ray meets nothing
    bool goes_on = false;
    FilmSample* film = nullptr;  ///< for the first vertex
};

struct Path::Memory final : IntegratorMemory {
    Memory(const TextureTable& of, std::uint64_t path)
        : textures(of),
          number(path),
          batch(of),
          vertices(vertices_max) {}

    /// Vertices that are shaded together: enough for the lanes of texture lookups, few enough for
    /// the nearest cache.
    static constexpr std::size_t vertices_max = 64;

    const TextureTable& textures;
    const std::uint64_t number;  ///< the integrator's
    std::vector<State> states;
    std::vector<std::uint32_t> active, lit;
    std::vector<Vec3> light;
    PlacementCache placements;
    TextureBatch batch;
    std::vector<Vertex> vertices;
};

Path::Path(const IntegratorScene& scene, const IntegratorSettings& settings, std::uint32_t depth)
    : scene_(scene.source),
      view_(scene.shading != nullptr ? *scene.shading : ShadingView{scene.source.scene}),
      lighting_(scene, settings),
      textures_(view_),
      depth_(depth) {
    static std::atomic<std::uint64_t> made{0};
    number_ = ++made;
}

bool Path::render(const SampleRange& range, RayCaster& caster, Wavefront& arrays,
                  std::span<FilmSample> out) const {
    if (!cast_camera_rays(range, caster, arrays)) return false;
    auto* kept = dynamic_cast<Memory*>(arrays.memory.get());
    if (kept == nullptr || &kept->textures != &textures_ || kept->number != number_) {
        auto fresh = std::make_unique<Memory>(textures_, number_);
        kept = fresh.get();
        arrays.memory = std::move(fresh);
    }
    Memory& memory = *kept;
    const RayCone cone = cone_of(range.camera);
    State start;
    start.width = cone_share * cone.width;
    start.spread = cone_share * cone.spread;
    std::vector<State>& states = memory.states;
    states.assign(out.size(), start);
    std::vector<std::uint32_t>& active = memory.active;
    active.resize(out.size());
    std::iota(active.begin(), active.end(), 0U);

    for (std::uint32_t bounce = 0; !active.empty(); ++bounce) {
        arrays.shadow_rays.clear();
        memory.light.clear();
        memory.lit.clear();
        const bool lights = bounce < depth_ && !lighting_.empty();
        std::size_t going = 0;
        for (std::size_t next = 0; next < active.size();) {
            std::size_t count = 0;
            for (; next < active.size() && count < memory.vertices.size(); ++next) {
                fetch_ahead(std::span(arrays.hits).first(active.size()), next);
                const std::uint32_t i = active[next];
                if (arrays.hits[next].hit == 0) {
                    leave(arrays.rays[next], bounce, states[i]);
                    continue;
                }
                Vertex& vertex = memory.vertices[count++];
                vertex.path = i;
                vertex.ray = static_cast<std::uint32_t>(next);
                vertex.film = bounce == 0 ? &out[i] : nullptr;
                locate(arrays.rays[next], arrays.hits[next], bounce, memory, states[i], vertex);
            }
            if (lights)
                for (Vertex& vertex : std::span(memory.vertices).first(count)) {
                    const Sampler sampler = sampler_of(range, arrays, vertex.path);
                    vertex.choice = draw(sampler, bounce, choices);
                    vertex.light_point = draw(sampler, bounce, light_point);
                    lighting_.fetch_guide(vertex.choice.x, vertex.light_point);
                }
            memory.batch.run();
            if (lights)
                for (const Vertex& vertex : std::span(memory.vertices).first(count))
                    lighting_.fetch_texels(vertex.choice.x, vertex.light_point);
            for (std::size_t k = 0; k < count; ++k) {
                Vertex& vertex = memory.vertices[k];
                const std::uint32_t i = vertex.path;
                shade(arrays.rays[vertex.ray], arrays.hits[vertex.ray],
                      sampler_of(range, arrays, i), bounce, states[i], vertex);
                if (!is_black(vertex.light)) {
                    arrays.shadow_rays.push_back(vertex.shadow);
                    memory.light.push_back(vertex.light);
                    memory.lit.push_back(i);
                }
                if (!vertex.goes_on) continue;
                // Never beyond the rays that were read.
                active[going] = i;
                arrays.rays[going++] = vertex.next;
            }
        }
        active.resize(going);

        const std::size_t lit = memory.lit.size();
        arrays.occluded.resize(lit);
        if (lit != 0 && !caster.occluded(arrays.shadow_rays, arrays.occluded)) return false;
        for (std::size_t k = 0; k < lit; ++k)
            if (arrays.occluded[k] == 0) states[memory.lit[k]].radiance += memory.light[k];
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

void Path::fetch_ahead(std::span<const HitRecord> hits, std::size_t at) const {
    // Far enough for memory to answer, near enough to stay in the nearest cache.
    constexpr std::size_t vertices = 6, corners = 12;
    if (at + corners < hits.size() && hits[at + corners].hit != 0)
        fetch_corners(*view_.scene, hits[at + corners]);
    if (at + vertices < hits.size() && hits[at + vertices].hit != 0)
        fetch_vertices(view_, hits[at + vertices]);
}

void Path::leave(const Ray& ray, std::uint32_t bounce, State& state) const {
    if (lighting_.empty()) return;
    const Vec3 direction = glm::normalize(ray.direction);
    const Environment::View far = lighting_.far(direction);
    if (is_black(far.radiance)) return;
    const float weight = state.density > 0 ? power_heuristic(state.density, far.density) : 1.0F;
    state.radiance += state.throughput * far.radiance * weight;
    if (bounce == 0) state.covered = 1;
}

void Path::locate(const Ray& ray, const HitRecord& hit, std::uint32_t bounce, Memory& memory,
                  State& state, Vertex& vertex) const {
    const Placement& placement = memory.placements.find(*view_.scene, hit.path);
    vertex.place = surface_point(scene_, ray, hit, placement);
    vertex.distance = hit.t * glm::length(ray.direction);
    state.width += state.spread * (bounce == 0 ? hit.t : vertex.distance);
    begin_point(view_, ray, hit, vertex.place.normal, vertex.place.twice_area, state.width,
                placement, memory.batch, vertex.point);
    vertex.light = Vec3(0);
    vertex.goes_on = false;
}

void Path::shade(const Ray& ray, const HitRecord& hit, const Sampler& sampler, std::uint32_t bounce,
                 State& state, Vertex& step) const {
    const SurfacePoint& place = step.place;
    const ShadingPoint& point = finish_point(step.point);
    if (step.film != nullptr) {
        describe_ids(*view_.scene, ray, hit, *step.film);
        step.film->albedo = point.material.base_colour;
        step.film->normal = point.frame.z;
    }
    const float distance = step.distance;
    if (point.material.inside) state.throughput *= absorbed(*point.surface, distance);

    const Vec3 outgoing = point.frame.to_local(step.point.viewer);
    with_material(point.kind, point.material, outgoing, [&](const auto& material) {
        const bool counts =
            material.lights_others || bounce == 0 || state.density >= mirror_density;
        const Vec3 emitted = material.emitted();
        if (counts && !is_black(emitted)) {
            const float cosine = std::abs(glm::dot(point.normal, step.point.viewer));
            const float other =
                state.density > 0 ? lighting_.triangle_density(hit, distance, cosine) : 0.0F;
            const float weight = other > 0 ? power_heuristic(state.density, other) : 1.0F;
            state.radiance += state.throughput * emitted * weight;
        }
        if (bounce >= depth_ || !material.scatters()) return;

        // Reflected light leaves on the viewer's side, also where it grazes the triangle from
        // below.
        const auto origin = [&](const Vec3& world, const Vec3& local) {
            return place.origin(local.z > 0 ? point.normal : world, point.shift(world, local));
        };
        const bool lights = !lighting_.empty();
        const Vec2 choice = lights ? step.choice : draw(sampler, bounce, choices);
        if (lights) {
            const LightSample light =
                lighting_.sample(Vec3(place.position), choice.x, step.light_point);
            const Vec3 incoming = point.frame.to_local(light.direction);
            if (light.density > 0 && !is_black(light.radiance) &&
                point.scatters(light.direction, incoming)) {
                const Scattered lit = scatter(material, incoming);
                const float weight =
                    light.can_be_met ? power_heuristic(light.density, lit.density) : 1.0F;
                step.light =
                    state.throughput * lit.value * light.radiance * (weight / light.density);
                step.shadow.origin = origin(light.direction, incoming);
                step.shadow.direction =
                    light.ends ? Vec3(light.end - glm::dvec3(step.shadow.origin)) : light.direction;
                step.shadow.tmax = light.ends ? 1.0F : std::numeric_limits<float>::infinity();
            }
        }

        const Vec3 incoming = material.sample(choice.y, draw(sampler, bounce, scattered));
        if (incoming == Vec3(0)) return;
        const Vec3 direction = glm::normalize(point.frame.to_world(incoming));
        const auto [value, density] = scatter(material, incoming);
        if (!(density > 0) || !point.scatters(direction, incoming)) return;
        state.throughput *= value / density;
        const float carried = largest(state.throughput);
        if (!(carried > 0)) return;
        if (bounce + 1 >= roulette_from) {
            const float survival = std::min(carried, roulette_most);
            if (draw(sampler, bounce, roulette).x >= survival) return;
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
