// The types that a pack and its host exchange, each with a hash of its layout.
//
// Both compile the list at the end of this file. A pack whose hashes differ was built against other
// headers: it is refused, and the refusal names the type (packs/load.cpp).
//
// The hash covers a type's size and alignment, and the name, offset, size, alignment and kind of
// each member in order; for an enumeration, the names of its values in order, since both sides
// index tables by them. It does not see what another number means: for that, increment pack_abi.
#pragma once

#include "engine/bvh/node.h"
#include "engine/geometry/triangle.h"
#include "engine/packs/abi.h"
#include "engine/packs/device.h"

#include <array>
#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <string_view>
#include <type_traits>

namespace raynest::layout {

/// FNV-1a, 64 bit.
class Hash {
public:
    constexpr void add(std::string_view text) {
        for (const char c : text)
            value_ = (value_ ^ static_cast<unsigned char>(c)) * 1099511628211U;
    }
    constexpr void add(std::uint64_t number) {
        for (int shift = 0; shift < 64; shift += 8) {
            value_ = (value_ ^ (number >> shift & 255U)) * 1099511628211U;
        }
    }
    [[nodiscard]] constexpr std::uint64_t value() const { return value_; }

private:
    std::uint64_t value_ = 14695981039346656037U;
};

/// The parts of a member of type T. Pointers to data are all alike; of functions all counts.
template <class T>
struct Shape {
    static constexpr void add_to(Hash& hash) {
        using Element = std::remove_all_extents_t<T>;
        constexpr std::uint64_t kind = std::is_floating_point_v<Element> ? 'f'
                                       : std::is_signed_v<Element>       ? 'i'
                                       : std::is_unsigned_v<Element>     ? 'u'
                                       : std::is_enum_v<Element>         ? 'e'
                                       : std::is_pointer_v<Element>      ? 'p'
                                                                         : 'c';
        hash.add(kind);
        hash.add(sizeof(T));
        hash.add(alignof(T));
    }
};
template <>
struct Shape<void> {
    static constexpr void add_to(Hash& hash) { hash.add('v'); }
};
template <class R, class... Arguments>
struct Shape<R (*)(Arguments...) noexcept> {
    static constexpr void add_to(Hash& hash) {
        hash.add('(');
        Shape<R>::add_to(hash);
        (Shape<Arguments>::add_to(hash), ...);
        hash.add(')');
    }
};

/// `whole` with its members in order, and their names.
template <class T, class... Members>
std::uint64_t hash_of(std::string_view names, const T& whole, const Members&... members) {
    static_assert(std::is_standard_layout_v<T>, "types of the interface are C types");
    Hash hash;
    hash.add(sizeof(T));
    hash.add(alignof(T));
    hash.add(names);
    const auto add = [&](const auto& member) {
        hash.add(static_cast<std::uint64_t>(reinterpret_cast<const std::byte*>(&member) -
                                            reinterpret_cast<const std::byte*>(&whole)));
        Shape<std::remove_cvref_t<decltype(member)>>::add_to(hash);
    };
    (add(members), ...);
    return hash.value();
}

/// An enumeration whose values count from 0: their names in order.
inline std::uint64_t hash_of_names(std::initializer_list<std::string_view> names) {
    Hash hash;
    for (const std::string_view name : names) {
        hash.add(name);
        hash.add(name.size());
    }
    return hash.value();
}

/// The type and all of its members; with one too few or too many it does not compile.
#define RAYNEST_LAYOUT(Type, ...)                           \
    ::raynest::TypeLayout {                                 \
#Type, [] {                                               \
            const Type whole{};                                   \
            const auto& [__VA_ARGS__] = whole;                    \
            return ::raynest::layout::hash_of(#__VA_ARGS__, whole, __VA_ARGS__); \
        }() \
    }

}  // namespace raynest::layout

namespace raynest {

// Members are named like functions of this namespace (bounds, normal, open).
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wshadow"

/// The members of Counters are those of its list.
inline TypeLayout counters_layout() {
    const Counters whole{};
    return {"Counters", layout::hash_of(
#define RAYNEST_COUNTER(name, title) #name " "
#define RAYNEST_SUM(...)
#include "engine/geometry/counters.def"
                            , whole
#define RAYNEST_COUNTER(name, title) , whole.name
#define RAYNEST_SUM(...)
#include "engine/geometry/counters.def"
                            )};
}

/// PackVariant::trace is indexed by these.
inline TypeLayout queries_layout() {
    return {"Query", layout::hash_of_names({
#define RAYNEST_KIND(name, ...) #name,
#include "engine/packs/words.def"
                     })};
}
inline TypeLayout traversals_layout() {
    return {"Traversal", layout::hash_of_names({
#define RAYNEST_TRAVERSAL(name, ...) #name,
#include "engine/packs/words.def"
                         })};
}

// An enumeration that grows must grow in the list below, too.
static_assert(static_cast<std::uint32_t>(AlphaMode::blend) == 2);
static_assert(static_cast<std::uint32_t>(Wrap::mirror) == 2);
static_assert(counter_modes == 3);
static_assert(static_cast<std::uint32_t>(value_table) == 3);

/// By value, so that no module shares the list of another.
inline auto border_types() {
    return std::to_array<TypeLayout>({
        // Indices of tables
        queries_layout(),
        traversals_layout(),
        {"AlphaMode", layout::hash_of_names({"opaque", "mask", "blend"})},
        {"Wrap", layout::hash_of_names({"repeat", "clamp", "mirror"})},
        {"CounterMode", layout::hash_of_names({"none", "total", "by_level"})},
        {"ValueType", layout::hash_of_names({"f32", "u32", "choice", "table"})},
        // A scene
        RAYNEST_LAYOUT(Box, lower, upper),
        RAYNEST_LAYOUT(Transform, m),
        RAYNEST_LAYOUT(ColumnTransform, m),
        RAYNEST_LAYOUT(Node, lower, upper, child, order),
        RAYNEST_LAYOUT(TriangleBlock, vertex, triangle),
        RAYNEST_LAYOUT(TexcoordBlock, corner),
        RAYNEST_LAYOUT(Opacity, least, largest),
        RAYNEST_LAYOUT(TextureRecord, colour, alpha, width, height, wrap_s, wrap_t, nearest,
                       unused),
        RAYNEST_LAYOUT(MaterialRecord, base_colour, uv_transform, texture, texcoord, alpha_mode,
                       cutoff, double_sided, name),
        RAYNEST_LAYOUT(GeometryRecord, positions, indices, texcoords, colours, opacity,
                       first_triangle, triangle_count, vertex_count, material),
        RAYNEST_LAYOUT(InstanceRecord, to_object, object, mask, path_base),
        RAYNEST_LAYOUT(InstanceInfo, to_parent, uid, name, mask),
        RAYNEST_LAYOUT(ObjectRecord, bounds, origin_error, root, first_node, first_block,
                       first_record, placement_count, texcoord_blocks, node_count, block_count,
                       triangle_count, first_geometry, geometry_count, first_instance,
                       instance_count, record_type, record_count, record_size, levels, name),
        RAYNEST_LAYOUT(CameraRecord, to_world, yfov, aspect, name, ymag),
        RAYNEST_LAYOUT(SceneView, nodes, blocks, records, objects, instances, instance_infos,
                       geometries, materials, textures, cameras, attributes, names, object_count,
                       instance_count, geometry_count, material_count, texture_count, camera_count,
                       root, masked_materials, blended_materials, cut_triangles),
        // A call
        RAYNEST_LAYOUT(Ray, origin, tmin, direction, tmax),
        RAYNEST_LAYOUT(HitRecord, t, u, v, triangle, path, object, k, front, flags, hit),
        counters_layout(),
        RAYNEST_LAYOUT(TraceCall, scene, params, rays, ray_count, hits_max, mask, flags, hits,
                       hit_counts, counters, outputs, hits_room, ray_flags, rays_done, cancelled,
                       cancelled_context, tables, observer, device),
        RAYNEST_LAYOUT(Table, values, count),
        // The observed steps
        RAYNEST_LAYOUT(Refusal, what, value, relation, limit),
        RAYNEST_LAYOUT(Step, kind, outcome, object, place, path, tested, passed, rejected, first,
                       nears, t, u, v, front, refusal),
        RAYNEST_LAYOUT(Observer, context, step, end, candidates),
        // A pack
        RAYNEST_LAYOUT(PackParam, name, text, type, choice_count, choices, minimum, maximum,
                       initial),
        RAYNEST_LAYOUT(PackOutput, name, text, type),
        RAYNEST_LAYOUT(PackVariant, name, text, params, param_count, output_count, outputs, trace,
                       observe),
        RAYNEST_LAYOUT(PackPrimitive, name, record_size, hits_max, bounds, normal),
        RAYNEST_LAYOUT(Pack, abi, type_count, types, target, kernel_count, supported, variants,
                       variant_count, primitive_count, primitives),
        // A device
        RAYNEST_LAYOUT(Pose, x, y, z, origin),
        RAYNEST_LAYOUT(SensorPose, pose, tmin, tmax),
        RAYNEST_LAYOUT(ImageSize, width, height),
        RAYNEST_LAYOUT(Pinhole, sensor_pose, size, center_x, center_y, step_x, step_y),
        RAYNEST_LAYOUT(PinholeRays, camera, first, tiles),
        RAYNEST_LAYOUT(DeviceInfo, name, memory_bytes, absent),
        RAYNEST_LAYOUT(ChangedRange, array, first, count, elements),
        RAYNEST_LAYOUT(Device, abi, open, error, pin, load, load_changed, unload, copied_bytes,
                       scene_bytes, make_slot, free_slot, start, finish, kernel_seconds),
    });
}

#pragma GCC diagnostic pop

}  // namespace raynest
