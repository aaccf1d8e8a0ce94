#include "engine/integrators/lighting.h"

#include "engine/integrators/surface_point.h"
#include "engine/shading/lights.h"
#include "engine/shading/shading_point.h"
#include "engine/shading/texture_lookup.h"

#include <algorithm>
#include <cmath>

namespace raynest {
namespace {

/// Where the sun stands when nobody says: 75 degrees beside the camera of a file without one, which
/// looks from the south-east, so that the three faces of a box that it sees differ.
constexpr float default_azimuth = 210;
constexpr float default_elevation = 55;

/// Turns less the whole ones: 0 to below 1.
float turn_part(double turns) {
    return std::min(static_cast<float>(turns - std::floor(turns)), one_below);
}

/// Mean brightness of a texture's copy times a colour.
float mean_brightness(const TexturePlane& plane, const Vec3& factor) {
    const std::size_t count = std::size_t{plane.width} * plane.height;
    const auto& linear = srgb_to_linear();
    double sum = 0;
    for (std::size_t i = 0; i < count; ++i) {
        const std::uint8_t* p = plane.rgba + 4 * i;
        if ((p[0] | p[1] | p[2]) == 0) continue;
        sum += static_cast<double>(
            brightness(factor * Vec3(linear[p[0]], linear[p[1]], linear[p[2]])));
    }
    return static_cast<float>(sum / static_cast<double>(count));
}

/// Mean brightness of what a material emits. A small copy of its texture is enough, unless it is
/// black: bytes round to 0 where few texels are lit, so a finer copy decides then.
float mean_brightness(const ShadingView& view, const SurfaceRecord& surface) {
    const float factor = brightness(surface.emission);
    const TextureUse& use = surface.use(TextureSlot::emission);
    if (!(factor > 0) || use.texture == no_id || view.levels == nullptr) return factor;
    constexpr std::uint32_t side_enough = 256;
    for (std::uint32_t level = view.levels[use.texture].count; level-- > 0;) {
        const TexturePlane plane = texture_plane(view, use.texture, level);
        if (level != 0 && std::max(plane.width, plane.height) < side_enough) continue;
        if (const float mean = mean_brightness(plane, surface.emission); mean > 0) return mean;
    }
    return 0;
}

glm::dmat4x3 placed(const glm::dmat4x3& outer, const ColumnTransform& to_object) {
    const std::array<float, 12>& m = to_object.m;
    const glm::dmat3 inverse =
        glm::inverse(glm::dmat3(m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8]));
    const glm::dvec3 shift = -(inverse * glm::dvec3(m[9], m[10], m[11]));
    const glm::dmat3 linear(outer[0], outer[1], outer[2]);
    const glm::dmat3 both = linear * inverse;
    return {both[0], both[1], both[2], linear * shift + outer[3]};
}

}  // namespace

Lighting::Lighting(const IntegratorScene& scene, const IntegratorSettings& settings)
    : source_(scene.source),
      view_(scene.shading != nullptr ? *scene.shading : ShadingView{scene.source.scene}) {
    for (std::uint32_t i = 0; i < view_.light_count; ++i) {
        const LightRecord& light = view_.lights[i];
        with_light(light.kind, [&](auto type) {
            if (!(brightness(light.intensity) > 0)) return;
            (type.distant ? far_lights_ : near_lights_).push_back(i);
            if (!type.distant) weights_.push_back(type.power(light));
        });
    }
    find_triangles(scene);
    for (const EmittingTriangle& t : triangles_) {
        const std::uint32_t material =
            view_.scene->geometry_of(view_.scene->objects[t.object], t.triangle).material;
        const float area = 0.5F * glm::length(glm::cross(t.edge1, t.edge2));
        weights_.push_back(2.0F * pi * area * material_brightness_[material]);
    }
    near_ = AliasTable(weights_);
    add_far(settings);
}

void Lighting::add_far(const IntegratorSettings& settings) {
    using Kind = IntegratorSettings::Environment;
    const bool automatic = settings.environment == Kind::automatic;
    // A lamp or a screen that emits does not light a whole scene; lights are made to do that.
    const bool file_has_lights = !near_lights_.empty() || !far_lights_.empty();
    const bool has_sky =
        settings.environment == Kind::sky || (automatic && (settings.sun || !file_has_lights));
    if (automatic && !settings.sun)
        notes_.emplace_back(
            file_has_lights ? "the file's lights light the scene, without a sky: `environment` sky "
                              "adds one"
            : near_.empty()
                ? "the scene has no lights: it is lit by a clear sky; `environment` and "
                  "`sun` choose another"
                : "the file has no lights but surfaces that emit: a clear sky is added; "
                  "`environment` none leaves it out");
    if (settings.environment == Kind::picture && settings.picture != nullptr) {
        const EnvironmentPicture& picture = *settings.picture;
        sky_.environment =
            Environment(picture.size.width, picture.size.height, picture.pixels,
                        turn_part(0.25 + static_cast<double>(settings.environment_rotate) / 360));
        if (picture.left_out != 0)
            notes_.push_back("the environment has " + std::to_string(picture.left_out) +
                             (picture.left_out == 1 ? " pixel" : " pixels") + " of " +
                             std::to_string(picture.pixels.size()) +
                             " whose values are infinite or no numbers: they light nothing; save "
                             "the picture without them");
    }
    if (has_sky || settings.sun) {
        Sky sky = make_sky(settings.sun ? settings.sun_azimuth : default_azimuth,
                           settings.sun ? settings.sun_elevation : default_elevation);
        sky_.sun = sky.sun;
        sky_.sun.direction = from_y_up(view_.up, sky.sun.direction);
        if (has_sky) sky_.environment = std::move(sky.environment);
    }
    sky_.environment.set_up(view_.up);
    has_sun_ = !is_black(sky_.sun.radiance);
    if (empty())
        notes_.emplace_back("nothing gives light: add lights, or ask for `environment` sky");
}

/// Goes to all triangles that emit light and that a ray can meet. Objects and instances are those of
/// IntegratorScene::seen, beside those of the scene, whose numbers and paths hits have.
class Lighting::Walk {
public:
    Walk(Lighting& lighting, const IntegratorScene& scene)
        : lighting_(lighting),
          scene_(scene.view()),
          seen_(scene.seen != nullptr ? *scene.seen : scene.view()),
          mask_(scene.mask),
          counts_(seen_.object_count, unknown) {}

    /// How many there are; far beyond emitting_triangles_max the number is only a lower bound.
    std::uint64_t count() { return count(seen_.root); }
    void add_all() {
        if (count() != 0) add(scene_.root, seen_.root, 0, glm::dmat4x3(1));
    }

private:
    static constexpr std::uint64_t unknown = ~0ULL;
    static constexpr std::uint64_t most = std::uint64_t{1} << 40;

    std::uint64_t count(std::uint32_t index) {
        if (counts_[index] != unknown) return counts_[index];
        const ObjectRecord& object = seen_.objects[index];
        std::uint64_t sum = 0;
        for (std::uint32_t g = 0; object.triangle_count != 0 && g < object.geometry_count; ++g) {
            const GeometryRecord& geometry = seen_.geometries[object.first_geometry + g];
            if (geometry.material != no_id && lighting_.material_brightness_[geometry.material] > 0)
                sum += geometry.triangle_count;
        }
        for (std::uint32_t i = 0; i < object.instance_count; ++i) {
            const InstanceRecord& instance = seen_.instances[object.first_instance + i];
            if ((instance.mask & mask_) != 0) sum = std::min(sum + count(instance.object), most);
        }
        return counts_[index] = sum;
    }

    void add(std::uint32_t index, std::uint32_t seen, std::uint64_t path,
             const glm::dmat4x3& to_world) {
        const ObjectRecord& object = scene_.objects[index];
        const ObjectRecord& as_seen = seen_.objects[seen];
        if (as_seen.triangle_count != 0) lighting_.add_triangles(index, path, to_world);
        for (std::uint32_t i = 0; i < object.instance_count; ++i) {
            const InstanceRecord& instance = scene_.instances[object.first_instance + i];
            const InstanceRecord& entered = seen_.instances[as_seen.first_instance + i];
            if ((entered.mask & mask_) == 0 || count(entered.object) == 0) continue;
            add(instance.object, entered.object, path + instance.path_base,
                placed(to_world, instance.to_object));
        }
    }

    Lighting& lighting_;
    const SceneView& scene_;
    const SceneView& seen_;
    const std::uint32_t mask_;
    std::vector<std::uint64_t> counts_;  ///< by object of seen_
};

void Lighting::find_triangles(const IntegratorScene& scene) {
    if (view_.surfaces == nullptr) return;
    const std::uint32_t materials = view_.scene->material_count;
    material_brightness_.resize(materials);
    for (std::uint32_t i = 0; i < materials; ++i)
        material_brightness_[i] = mean_brightness(view_, view_.surfaces[i]);
    Walk walk(*this, scene);
    if (const std::uint64_t all = walk.count(); all > emitting_triangles_max) {
        notes_.push_back(std::to_string(all) + " triangles emit light; with more than " +
                         std::to_string(emitting_triangles_max) +
                         " they are met by chance alone, and pictures have more noise");
        std::ranges::fill(material_brightness_, 0.0F);
        return;
    }
    walk.add_all();
}

void Lighting::add_triangles(std::uint32_t index, std::uint64_t path,
                             const glm::dmat4x3& to_world) {
    const SceneView& scene = *view_.scene;
    const ObjectRecord& object = scene.objects[index];
    for (std::uint32_t g = 0; g < object.geometry_count; ++g) {
        const GeometryRecord& geometry = scene.geometries[object.first_geometry + g];
        if (geometry.material == no_id || !(material_brightness_[geometry.material] > 0)) continue;
        const auto* corners = scene.attribute<std::uint32_t>(geometry.indices);
        const auto* positions = scene.attribute<Vec3>(geometry.positions);
        for (std::uint32_t i = 0; i < geometry.triangle_count; ++i) {
            const auto world = [&](std::uint32_t corner) {
                return to_world * glm::dvec4(positions[corners[3 * i + corner]], 1);
            };
            const glm::dvec3 v0 = world(0);
            EmittingTriangle t{Vec3(v0), Vec3(world(1) - v0),        Vec3(world(2) - v0), 0,
                               index,    geometry.first_triangle + i};
            const Vec3 normal = glm::cross(t.edge1, t.edge2);
            if (!(glm::dot(normal, normal) > 0) || !std::isfinite(glm::dot(normal, normal)))
                continue;
            HitRecord middle;
            middle.u = middle.v = 1.0F / 3;
            middle.path = path;
            middle.object = index;
            middle.triangle = t.triangle;
            middle.hit = 1;
            t.lift = static_cast<float>(surface_point(source_, Ray{}, middle).lift);
            triangles_.push_back(t);
        }
    }
}

LightSample Lighting::sample(const Vec3& from, float choice, const Vec2& u) const {
    const float share = near_share();
    if (choice < share) {
        LightSample sample = sample_near(from, choice / share, u);
        sample.density *= share;
        return sample;
    }
    if (far_count() == 0) return {};
    LightSample sample =
        sample_far(from, std::min((choice - share) / (1.0F - share), one_below), u);
    sample.density *= 1.0F - share;
    return sample;
}

LightSample Lighting::sample_near(const Vec3& from, float choice, const Vec2& u) const {
    const std::uint32_t drawn = near_.draw(choice);
    const float probability = weights_[drawn] / near_.total();
    LightSample sample;
    if (drawn < near_lights_.size()) {
        const LightRecord& light = view_.lights[near_lights_[drawn]];
        sample = with_light(light.kind, [&](auto type) { return type.sample(light, from, u); });
    } else {
        sample = sample_triangle_light(triangles_[drawn - near_lights_.size()], from, u);
    }
    sample.density *= probability;
    return sample;
}

LightSample Lighting::sample_triangle_light(const EmittingTriangle& t, const Vec3& from,
                                            const Vec2& u) const {
    LightSample sample;
    const Vec2 b = sample_triangle(u);
    const glm::dvec3 at = glm::dvec3(t.corner) + static_cast<double>(b.x) * glm::dvec3(t.edge1) +
                          static_cast<double>(b.y) * glm::dvec3(t.edge2);
    const Vec3 cross = glm::cross(t.edge1, t.edge2);
    const float twice_area = glm::length(cross);
    const Vec3 normal = cross / twice_area;
    const Vec3 way(at - glm::dvec3(from));
    const float distance2 = glm::dot(way, way);
    if (!(distance2 > 0)) return sample;
    sample.distance = std::sqrt(distance2);
    sample.direction = way / sample.distance;
    const float cosine = glm::dot(sample.direction, normal);
    if (!(std::abs(cosine) > 1e-6F)) return sample;
    sample.density = distance2 / (std::abs(cosine) * 0.5F * twice_area);
    sample.radiance =
        triangle_emission(view_, view_.scene->objects[t.object], t.triangle, b.x, b.y);
    sample.can_be_met = true;
    sample.end = at - static_cast<double>(std::copysign(t.lift, cosine)) * glm::dvec3(normal);
    sample.ends = true;
    return sample;
}

LightSample Lighting::sample_far(const Vec3& from, float choice, const Vec2& u) const {
    const auto count = static_cast<float>(far_count());
    auto drawn = std::min(static_cast<std::size_t>(choice * count), far_count() - 1);
    LightSample sample;
    if (drawn < far_lights_.size()) {
        const LightRecord& light = view_.lights[far_lights_[drawn]];
        sample = with_light(light.kind, [&](auto type) { return type.sample(light, from, u); });
        sample.density /= count;
        return sample;
    }
    drawn -= far_lights_.size();
    // Sun and sky overlap: the density is that of drawing the direction by either.
    Environment::View view;
    if (has_sun_ && drawn == 0) {
        sample.direction = sky_.sun.sample(u);
        view = sky_.environment.view(sample.direction);
    } else {
        sample.direction = sky_.environment.sample(u, view);
        if (!(view.density > 0)) return {};
    }
    view = with_sun(view, sample.direction);
    sample.radiance = view.radiance;
    sample.density = view.density / count;
    sample.can_be_met = true;
    return sample;
}

Environment::View Lighting::with_sun(Environment::View view, const Vec3& direction) const {
    if (has_sun_ && sky_.sun.contains(direction)) {
        view.radiance += sky_.sun.radiance;
        view.density += sky_.sun.density();
    }
    return view;
}

Environment::View Lighting::far(const Vec3& direction) const {
    const std::size_t count = far_count();
    if (count == 0) return {};
    Environment::View view = with_sun(sky_.environment.view(direction), direction);
    view.density *= (1.0F - near_share()) / static_cast<float>(count);
    return view;
}

float Lighting::triangle_density(const HitRecord& hit, float distance, float cosine) const {
    if (triangles_.empty() || !(cosine > 0)) return 0;
    const SceneView& scene = *view_.scene;
    const std::uint32_t material =
        scene.geometry_of(scene.objects[hit.object], hit.triangle).material;
    if (material == no_id) return 0;
    // The area cancels: a triangle is drawn in proportion to it.
    const float per_area = 2.0F * pi * material_brightness_[material] / near_.total();
    return near_share() * per_area * distance * distance / cosine;
}

}  // namespace raynest
