#include "server/documents/light_path_json.h"

#include "server/documents/named_hit.h"

#include <cstddef>

namespace raynest::server {
namespace {

constexpr std::array<const char*, 3> ray_kind_names = {"camera", "bounce", "shadow"};

Json path_ray_json(const HitNames& names, const WorldPoint& origin, const PathRay& ray) {
    Json json{{"kind", ray_kind_names[static_cast<std::size_t>(ray.kind)]},
              {"parent", ray.parent == no_id ? Json(nullptr) : Json(ray.parent)},
              {"bounce", ray.bounce}};
    json.update(ray_json(ray.ray, origin));
    if (ray.kind == PathRayKind::shadow) json["blocked"] = ray.blocked;
    json["hit"] = names.hit(ray.ray, ray.hit);
    return json;
}

}  // namespace

std::string path_json(const Plan& plan, const PathContext& context, const FilmSample& sample,
                      std::span<const PathRay> rays) {
    const Snapshot& scene = plan.scene.snapshot();
    const HitNames names(scene, context.limits.name_bytes_max);
    const Vec3& light = sample.radiance;
    Json json{{"scene", plan.scene.name},
              {"hash", scene.digest()},
              {"epoch", plan.scene.epoch},
              {"intersector", plan.variant->name},
              {"target", plan.variant->target},
              {"camera", context.camera},
              {"size", {context.width, context.height}},
              {"pixel", context.pixel},
              {"integrator", context.integrator},
              {"seed", context.seed},
              {"sample", context.sample},
              {"radiance", {number(light.x), number(light.y), number(light.z)}},
              {"alpha", number(sample.alpha)},
              {"rays", Json::array()}};
    for (const PathRay& ray : rays)
        json["rays"].push_back(path_ray_json(names, scene.origin(), ray));
    return text_of(json);
}

}  // namespace raynest::server
