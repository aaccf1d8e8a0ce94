#include "server/documents/named_hit.h"

#include "protocol/text.h"
#include "server/documents/scene_info.h"

namespace raynest::server {

Json HitNames::primitive(std::uint32_t object, std::uint32_t flat) const {
    const SceneView& view = scene_.view();
    const NamedPrimitive named = name_primitive(view, view.objects[object], flat);
    Json json{{"type", type(view.objects[object])},
              {"geom", named.geom},
              {"prim", named.prim},
              {"material", nullptr}};
    if (named.material != no_id)
        json["material"] =
            protocol::clean_text(view.names + view.materials[named.material].name, name_bytes_);
    return json;
}

Json HitNames::hit(const Ray& ray, const HitRecord& hit) const {
    if (hit.hit == 0) return nullptr;
    Json json = primitive(hit.object, hit.triangle);
    json["t"] = number(hit.t);
    json["u"] = number(hit.u);
    json["v"] = number(hit.v);
    json["front"] = hit.front != 0;
    json["position"] = world_point(point_along(ray.origin, ray.direction, hit.t), scene_.origin());
    json["path"] = hit.path;
    json["name"] = placement({hit.path, 1}, path_steps_max);
    json["mesh"] = mesh(hit.object);
    return json;
}

std::string HitNames::placement(const PlacementRange& placements, std::size_t depth) const {
    return protocol::clean_text(instance_path(scene_, placements, depth), name_bytes_);
}

std::string HitNames::type(const ObjectRecord& object) const {
    for (const std::string& name : scene_.record_types()) {
        if (primitive_type(name.c_str()) == object.record_type)
            return protocol::clean_text(name, name_bytes_);
    }
    return "triangle";
}

std::string HitNames::mesh(std::uint32_t object) const {
    const SceneView& view = scene_.view();
    return protocol::clean_text(view.names + view.objects[object].name, name_bytes_);
}

Json ray_json(const Ray& ray, const WorldPoint& origin) {
    return {{"origin", world_point(ray.origin, origin)},
            {"direction", world_point(ray.direction, {})},
            {"tmin", number(ray.tmin)},
            {"tmax", number(ray.tmax)}};
}

}  // namespace raynest::server
