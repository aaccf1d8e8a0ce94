#include "engine/queries/columns.h"

#include "engine/intersectors/texture.h"
#include "engine/queries/base_colour.h"
#include "engine/queries/triangle_place.h"
#include "engine/scene/motion/velocities.h"
#include "engine/shading/records.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstring>
#include <utility>

namespace raynest {
namespace {

/// The types and words of fields.def.
namespace def {
struct Type {
    FieldType type;
    std::uint32_t width;
};
constexpr Type u8{FieldType::u8, 1}, u32{FieldType::u32, 1}, u64{FieldType::u64, 1};
constexpr Type f32{FieldType::f32, 1}, vec2{FieldType::f32, 2}, vec3{FieldType::f32, 3};
constexpr Type point = vec3, truth = u8;
constexpr bool hit = false, ray = true;
struct Reads {
    bool rays, motion, sensor;
};
constexpr Reads record{false, false, false}, rays{true, false, false}, motion{true, true, false},
    sensor{true, false, true};
}  // namespace def

/// In the order of Field.
constexpr std::array fields = {
#define RAYNEST_FIELD(name, kind, of, reads, shown, text) \
    FieldInfo{#name,                                      \
              def::kind.type,                             \
              def::kind.width,                            \
              false,                                      \
              def::of,                                    \
              def::reads.rays,                            \
              def::reads.motion,                          \
              def::reads.sensor,                          \
              FieldInfo::Shown::shown,                    \
              {}},
#include "engine/queries/fields.def"
#define RAYNEST_COUNTER(name, title)                                          \
    FieldInfo{#name, FieldType::u32,          1,    true, true, false, false, \
              false, FieldInfo::Shown::asked, title},
#include "engine/geometry/counters.def"
};
static_assert(fields.size() == static_cast<std::size_t>(Field::count_));

const ObjectRecord& object_of(const ColumnSource& source, const HitRecord& hit) {
    return source.scene->objects[hit.object];
}

/// Null for a record: those belong to no geometry.
const GeometryRecord* geometry_of(const ColumnSource& source, const HitRecord& hit) {
    const ObjectRecord& object = object_of(source, hit);
    return object.triangle_count == 0 ? nullptr : &source.scene->geometry_of(object, hit.triangle);
}

/// Index of the outermost instance in the root, or no_id; `innermost` in the whole scene.
struct Ends {
    std::uint32_t outermost = no_id;
    std::uint32_t innermost = no_id;
};

Ends ends_of(const SceneView& scene, std::uint64_t path) {
    Ends ends;
    walk_path(scene, path, [&](std::uint32_t index) {
        if (ends.outermost == no_id) {
            ends.outermost = index - scene.objects[scene.root].first_instance;
        }
        ends.innermost = index;
    });
    return ends;
}

/// User id of a placement: where the scene was read from a tree, the index of its node there.
std::uint32_t uid_of(const ColumnSource& source, std::uint64_t path) {
    const PathTable* const paths = source.paths;
    if (paths != nullptr && paths->node_count != 0)
        return paths->nodes[paths->run_of(path).node].source;
    const std::uint32_t innermost = ends_of(*source.scene, path).innermost;
    return innermost == no_id ? no_id : source.scene->instance_infos[innermost].uid;
}

Vec3 world_position(const Ray& ray, float t) {
    return point_along(ray.origin, ray.direction, t);
}

/// Object-space e1 x e2, in double so that the edges of tiny triangles do not underflow.
glm::dvec3 triangle_normal(const SceneView& scene, const GeometryRecord& geometry,
                           std::uint32_t triangle) {
    const std::uint32_t* corner = scene.attribute<std::uint32_t>(geometry.indices) +
                                  std::size_t{3} * (triangle - geometry.first_triangle);
    const Vec3* position = scene.attribute<Vec3>(geometry.positions);
    const glm::dvec3 v0(position[corner[0]]);
    return glm::cross(glm::dvec3(position[corner[1]]) - v0, glm::dvec3(position[corner[2]]) - v0);
}

/// Outward normal of the hit record in object space; zero where its type defines none.
glm::dvec3 record_normal(const ColumnSource& source, const HitRecord& hit, const Vec3& point) {
    const ObjectRecord& object = object_of(source, hit);
    const RecordNormal normal_of = source.record_normal == nullptr
                                       ? nullptr
                                       : source.record_normal(object.record_type, source.context);
    if (normal_of == nullptr) return glm::dvec3(0);
    const float at[3] = {point.x, point.y, point.z};
    float normal[3] = {0, 0, 0};
    normal_of(source.scene->record_of(object, hit.triangle), at, normal);
    return {normal[0], normal[1], normal[2]};
}

/// A normal is a covector: the transposed world-to-object map takes it to the world, and keeps it
/// outward where the placement mirrors.
glm::dvec3 normal_to_world(const Transform& to_object, const glm::dvec3& n) {
    const auto m = [&](std::size_t i) { return static_cast<double>(to_object.m[i]); };
    return {m(0) * n.x + m(4) * n.y + m(8) * n.z, m(1) * n.x + m(5) * n.y + m(9) * n.z,
            m(2) * n.x + m(6) * n.y + m(10) * n.z};
}

/// The interpolated normal of the vertices in the world; world_normal() where they have none.
Vec3 vertex_normal(const ColumnSource& source, const Ray& ray, const HitRecord& hit) {
    const GeometryRecord* const geometry = geometry_of(source, hit);
    const std::uint64_t offset = geometry == nullptr || source.shading == nullptr
                                     ? no_offset
                                     : source.shading[geometry - source.scene->geometries].normals;
    if (offset != no_offset) {
        const auto* const corner = source.scene->attribute<std::uint32_t>(geometry->indices) +
                                   std::size_t{3} * (hit.triangle - geometry->first_triangle);
        const auto* const normals = source.scene->attribute<Vec3>(offset);
        const auto of = [&](std::size_t i) { return glm::dvec3(normals[corner[i]]); };
        const double u{hit.u}, v{hit.v};
        const glm::dvec3 world = normal_to_world(world_to_object(*source.scene, hit.path),
                                                 (1 - u - v) * of(0) + u * of(1) + v * of(2));
        const double length = glm::length(world);
        if (length > 0) return Vec3(world / length);
    }
    return world_normal(source, ray, hit);
}

/// The coordinates of a hit in the set of its material.
Vec2 texture_place(const ColumnSource& source, const HitRecord& hit) {
    const GeometryRecord* const geometry = geometry_of(source, hit);
    if (geometry == nullptr) return Vec2(0);
    const std::uint32_t set =
        geometry->material == no_id ? 0 : source.scene->materials[geometry->material].texcoord;
    if (set > 1 || geometry->texcoords[set] == no_offset) return Vec2(0);
    return texture_coordinates(*source.scene, *geometry, set, hit.triangle, hit.u, hit.v);
}

float reflectance(const ColumnSource& source, const Ray& ray, const HitRecord& hit) {
    const glm::dvec3 luminance(0.2126, 0.7152, 0.0722);  // ITU-R BT.709
    const glm::dvec3 way(ray.direction);
    const double cosine =
        std::min(1.0, std::abs(glm::dot(glm::dvec3(vertex_normal(source, ray, hit)), way)) /
                          glm::length(way));
    return static_cast<float>(glm::dot(luminance, glm::dvec3(base_colour(*source.scene, hit))) *
                              cosine);
}

glm::dvec3 velocity(const ColumnSource& source, const Ray& ray, const HitRecord& hit) {
    const SceneView& scene = *source.scene;
    const std::uint32_t outermost = ends_of(scene, hit.path).outermost;
    if (source.velocities == nullptr || outermost == no_id) return glm::dvec3(0);
    const glm::dvec3 point =
        glm::dvec3(ray.origin) + static_cast<double>(hit.t) * glm::dvec3(ray.direction);
    const glm::dvec3 carried = source.velocities->of_instance(outermost, point);
    const std::uint32_t index = scene.objects[scene.root].first_instance + outermost;
    const GeometryRecord* const geometry = geometry_of(source, hit);
    if (geometry == nullptr || scene.instances[index].object != hit.object) return carried;
    const auto* const corners = scene.attribute<std::uint32_t>(geometry->indices) +
                                std::size_t{3} * (hit.triangle - geometry->first_triangle);
    const double u{hit.u}, v{hit.v};
    const glm::dvec3 bent = source.velocities->of_vertices(
        outermost,
        static_cast<std::uint32_t>(geometry - scene.geometries -
                                   object_of(source, hit).first_geometry),
        corners, {1 - u - v, u, v});
    return carried + map_vector(affine_of(scene.instance_infos[index].to_parent), bent);
}

/// Calls f(i, hit, ray) for every element.
template <class F>
void for_each_element(const ColumnSource& source, F&& f) {
    // Copies, because what `f` writes might be the source, for all that a compiler knows.
    const std::span<const Ray> rays = source.rays;
    const std::span<const HitRecord> hits = source.hits;
    const std::span<const std::uint32_t> ray_of = source.ray_of;
    const std::span<const std::uint32_t> order = source.order;
    if (hits.empty()) {
        static constexpr HitRecord miss{};
        for (std::size_t i = 0; i < rays.size(); ++i) f(i, miss, rays[i]);
    } else if (order.empty() && ray_of.empty()) {
        for (std::size_t i = 0; i < hits.size(); ++i) f(i, hits[i], rays[i]);
    } else {
        const std::size_t count = order.empty() ? hits.size() : order.size();
        for (std::size_t i = 0; i < count; ++i) {
            const std::size_t at = order.empty() ? i : order[i];
            f(i, hits[at], rays[ray_of.empty() ? at : ray_of[at]]);
        }
    }
}

/// `value(hit, ray)` is asked for hits only, misses get `miss`.
template <class T, class Value>
void write_each(const ColumnSource& source, std::byte* out, const T& miss, Value&& value) {
    if (source.hits.empty()) {
        std::fill_n(reinterpret_cast<T*>(out), source.rays.size(), miss);
        return;
    }
    for_each_element(source, [&](std::size_t i, const HitRecord& hit, const Ray& ray) {
        const T element = hit.hit != 0 ? T(value(hit, ray)) : miss;
        std::memcpy(out + i * sizeof(T), &element, sizeof(T));
    });
}

/// `value(hit, ray)` is asked for misses, too.
template <class Value>
void write_always(const ColumnSource& source, std::byte* out, Value&& value) {
    for_each_element(source, [&](std::size_t i, const HitRecord& hit, const Ray& ray) {
        const auto element = value(hit, ray);
        std::memcpy(out + i * sizeof element, &element, sizeof element);
    });
}

const SensorAt& sensor_of(const ColumnSource& source, std::size_t element) {
    return source.sensors[source.ray_of.empty() ? element : source.ray_of[element]];
}

void write_sensor_positions(const ColumnSource& source, std::byte* out) {
    for_each_element(source, [&](std::size_t i, const HitRecord& hit, const Ray& ray) {
        Vec3 place(0);
        if (hit.hit != 0 && !source.sensors.empty()) {
            const Pose& pose = sensor_of(source, i).pose;
            const glm::dvec3 from = glm::dvec3(ray.origin) - pose.origin +
                                    static_cast<double>(hit.t) * glm::dvec3(ray.direction);
            place = Vec3(glm::dot(pose.x, from), glm::dot(pose.y, from), glm::dot(pose.z, from));
        }
        std::memcpy(out + i * sizeof place, &place, sizeof place);
    });
}

void write_radial_velocities(const ColumnSource& source, std::byte* out) {
    for_each_element(source, [&](std::size_t i, const HitRecord& hit, const Ray& ray) {
        float along = 0;
        if (hit.hit != 0) {
            glm::dvec3 relative = velocity(source, ray, hit);
            if (!source.sensors.empty()) relative -= glm::dvec3(sensor_of(source, i).velocity);
            const glm::dvec3 way(ray.direction);
            along = static_cast<float>(glm::dot(relative, way) / glm::length(way));
        }
        std::memcpy(out + i * sizeof along, &along, sizeof along);
    });
}

/// One count per ray: of a level, or the sum of all.
template <class Value>
void write_counter(const ColumnSource& source, std::uint32_t level, std::byte* out, Value&& value) {
    const std::size_t sets = source.counter_sets;
    const std::size_t rays = source.counters.size() / sets;
    for (std::size_t i = 0; i < rays; ++i) {
        const auto of_ray = source.counters.subspan(i * sets, sets);
        std::uint32_t count = 0;
        if (level == Column::all_levels) {
            for (const Counters& c : of_ray) count += value(c);
        } else if (level < sets) {
            count = value(of_ray[level]);
        }
        std::memcpy(out + i * sizeof count, &count, sizeof count);
    }
}

}  // namespace

const FieldInfo& field_info(Field field) {
    return fields[static_cast<std::size_t>(field)];
}

std::size_t field_bytes(Field field) {
    const FieldInfo& info = field_info(field);
    switch (info.type) {
        case FieldType::u8:
            return info.width;
        case FieldType::u32:
        case FieldType::f32:
            return std::size_t{4} * info.width;
        case FieldType::u64:
            return std::size_t{8} * info.width;
    }
    return 0;
}

std::span<const FieldInfo> field_table() {
    return fields;
}

std::span<const FieldInfo> counter_table() {
    return field_table().subspan(static_cast<std::size_t>(
        std::find_if(fields.begin(), fields.end(), [](const FieldInfo& f) { return f.counter; }) -
        fields.begin()));
}

Result<Field> parse_field(std::string_view name) {
    std::string known;
    for (const FieldInfo& field : fields) {
        if (field.name == name) return static_cast<Field>(&field - fields.data());
        known += (known.empty() ? "" : ", ") + std::string(field.name);
    }
    return fail(ErrorCode::field_invalid,
                "there is no column '" + std::string(name) + "'; known: " + known);
}

Result<Column> parse_column(std::string_view name) {
    const auto dot = name.find('.');
    const auto field = parse_field(name.substr(0, dot));
    if (!field || dot == std::string_view::npos)
        return field.map([](Field f) { return Column(f); });
    const auto refused = [&](const std::string& why) {
        std::string message = "there is no column '";
        message.append(name).append("': ").append(why);
        return fail(ErrorCode::field_invalid, std::move(message));
    };
    if (!field_info(*field).counter)
        return refused("only counters have levels, as in boxes.0; take " +
                       std::string(field_info(*field).name));
    const std::string_view text = name.substr(dot + 1);
    std::uint32_t level = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), level);
    if (error != std::errc{} || std::to_string(level) != text || level == Column::all_levels)
        return refused("behind the dot stands a level: 0 for the root, 1 below it, and so on");
    return Column(*field, level);
}

std::string column_name(const Column& column) {
    std::string name(field_info(column.field).name);
    if (column.of_level()) name.append(".").append(std::to_string(column.level));
    return name;
}

Result<void> check_level(const Column& column, std::uint32_t levels) {
    if (!column.of_level() || column.level < levels) return {};
    std::string message = "there is no column '";
    message.append(column_name(column)).append("': the scene has ");
    if (levels == 1) {
        message.append("one level, level 0");
    } else {
        message.append(std::to_string(levels)).append(" levels, 0 to ");
        message.append(std::to_string(levels - 1));
    }
    return fail(ErrorCode::field_invalid, std::move(message));
}

void write_column(const Column& column, const ColumnSource& source, std::byte* out) {
    using Hit = const HitRecord&;
    using At = const Ray&;
    const auto each = [&](auto miss, auto&& value) { write_each(source, out, miss, value); };
    const auto always = [&](auto&& value) { write_always(source, out, value); };
    const auto counter = [&](auto&& value) { write_counter(source, column.level, out, value); };
    const SceneView* const scene = source.scene;  // null where all columns are counters
    switch (column.field) {
        case Field::hit:
            return each(std::uint8_t{0}, [](Hit, At) { return 1; });
        case Field::t:
            return each(std::numeric_limits<float>::infinity(), [](Hit h, At) { return h.t; });
        case Field::prim:
            return each(no_id, [&](Hit h, At) {
                const GeometryRecord* geometry = geometry_of(source, h);
                return geometry == nullptr ? h.triangle : h.triangle - geometry->first_triangle;
            });
        case Field::geom:
            return each(no_id, [&](Hit h, At) {
                const GeometryRecord* geometry = geometry_of(source, h);
                const GeometryRecord* first =
                    scene->geometries + object_of(source, h).first_geometry;
                return geometry == nullptr ? 0 : geometry - first;
            });
        case Field::path:
            return each(no_path, [](Hit h, At) { return h.path; });
        case Field::inst:
            return each(no_id, [&](Hit h, At) { return ends_of(*scene, h.path).outermost; });
        case Field::uid:
            return each(no_id, [&](Hit h, At) { return uid_of(source, h.path); });
        case Field::uv:
            return each(Vec2(0), [&](Hit h, At) {
                return geometry_of(source, h) == nullptr ? Vec2(0) : Vec2(h.u, h.v);
            });
        case Field::ng:
            return each(Vec3(0), [&](Hit h, At ray) { return world_normal(source, ray, h); });
        case Field::front:
            return each(std::uint8_t{0}, [](Hit h, At) { return h.front; });
        case Field::position:
            return each(Vec3(0), [](Hit h, At ray) { return world_position(ray, h.t); });
        case Field::material:
            return each(no_id, [&](Hit h, At) {
                const GeometryRecord* geometry = geometry_of(source, h);
                return geometry == nullptr ? no_id : geometry->material;
            });
        case Field::flags:
            return always([](Hit h, At) { return h.flags; });
        case Field::object:
            return each(no_id, [](Hit h, At) { return h.object; });
        case Field::mask:
            return each(no_id, [&](Hit h, At) {
                const std::uint32_t innermost = ends_of(*scene, h.path).innermost;
                return innermost == no_id ? no_id : scene->instances[innermost].mask;
            });
        case Field::box_share:
            return each(0.0F, [&](Hit h, At) {
                return geometry_of(source, h) == nullptr
                           ? 0.0F
                           : box_share(*scene, object_of(source, h), h.triangle);
            });
        case Field::tree_depth:
            return each(no_id, [&](Hit h, At) {
                return geometry_of(source, h) == nullptr
                           ? no_id
                           : tree_depth(*scene, object_of(source, h), h.triangle, h.u, h.v);
            });
        case Field::normal:
            return each(Vec3(0), [&](Hit h, At ray) { return vertex_normal(source, ray, h); });
        case Field::texcoord:
            return each(Vec2(0), [&](Hit h, At) { return texture_place(source, h); });
        case Field::base_colour:
            return each(Vec3(0), [&](Hit h, At) { return base_colour(*scene, h); });
        case Field::reflectance:
            return each(0.0F, [&](Hit h, At ray) { return reflectance(source, ray, h); });
        case Field::velocity:
            return each(Vec3(0), [&](Hit h, At ray) { return Vec3(velocity(source, ray, h)); });
        case Field::radial_velocity:
            return write_radial_velocities(source, out);
        case Field::sensor_position:
            return write_sensor_positions(source, out);
        case Field::origin:
            return always([](Hit, At ray) { return ray.origin; });
        case Field::direction:
            return always([](Hit, At ray) { return ray.direction; });
#define RAYNEST_COUNTER(name, title) \
    case Field::name:                \
        return counter([](const Counters& c) { return c.name; });
#define RAYNEST_SUM(name, value, title) \
    case Field::name:                   \
        return counter([](const Counters& c) { return value; });
#include "engine/geometry/counters.def"
        case Field::count_:
            return;
    }
}

Transform world_to_object(const SceneView& scene, std::uint64_t path) {
    Transform all;
    walk_path(scene, path, [&](std::uint32_t index) {
        all = compose(by_rows(scene.instances[index].to_object), all);
    });
    return all;
}

Vec3 world_normal(const ColumnSource& source, const Ray& ray, const HitRecord& hit) {
    const SceneView& scene = *source.scene;
    const Transform to_object = world_to_object(scene, hit.path);
    const GeometryRecord* geometry = geometry_of(source, hit);
    const glm::dvec3 n =
        geometry == nullptr
            ? record_normal(source, hit, to_object.point(world_position(ray, hit.t)))
            : triangle_normal(scene, *geometry, hit.triangle);

    const glm::dvec3 world = normal_to_world(to_object, n);
    const double length = glm::length(world);
    return length > 0 ? Vec3(world / length) : Vec3(0);
}

}  // namespace raynest
