#include "engine/scene/checks/description_check.h"

#include "engine/bvh/node.h"
#include "engine/scene/checks/shading_check.h"
#include "engine/scene/graph.h"
#include "engine/scene/snapshot.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <set>
#include <span>
#include <string>
#include <string_view>

namespace raynest {
namespace {

bool all_finite(std::span<const float> values) {
    return std::all_of(values.begin(), values.end(), [](float x) { return std::isfinite(x); });
}

/// True if all coordinates are within the limit; false for NaN and infinity.
bool in_range(const Vec3& p) {
    return std::abs(p.x) <= coordinate_max && std::abs(p.y) <= coordinate_max &&
           std::abs(p.z) <= coordinate_max;
}

bool is_reference(std::uint32_t index, std::size_t count) {
    return index == no_id || index < count;
}

tl::unexpected<Error> invalid(const std::string& what) {
    return fail(ErrorCode::scene_invalid, what);
}

Result<void> check_surfaces(const SceneDescription& description) {
    for (std::size_t i = 0; i < description.images.size(); ++i) {
        const ImageDescription& image = description.images[i];
        const std::uint64_t pixels = std::uint64_t{image.width} * image.height;
        if (image.width > texture_side_max || image.height > texture_side_max) {
            return fail(ErrorCode::limit_exceeded,
                        "image #" + std::to_string(i) + " is larger than " +
                            std::to_string(texture_side_max) + " pixels on a side: scale it down");
        }
        if (pixels == 0 || image.rgba.size() != 4 * pixels) {
            return invalid("image #" + std::to_string(i) + " does not hold width x height pixels");
        }
    }
    for (std::size_t i = 0; i < description.textures.size(); ++i) {
        const TextureDescription& texture = description.textures[i];
        if (texture.image >= description.images.size() || texture.wrap_s > Wrap::mirror ||
            texture.wrap_t > Wrap::mirror) {
            return invalid("texture #" + std::to_string(i) +
                           " names an image or a wrap mode that does not exist");
        }
    }
    for (const MaterialDescription& material : description.materials) {
        const Vec4& colour = material.base_colour;
        if (!all_finite(material.uv_transform) || !std::isfinite(material.cutoff) ||
            !std::isfinite(colour.x + colour.y + colour.z + colour.w)) {
            return invalid("material '" + material.name + "' has a number that is not finite");
        }
        if (!is_reference(material.texture, description.textures.size()) || material.texcoord > 1 ||
            material.alpha_mode > AlphaMode::blend) {
            return invalid(
                "material '" + material.name +
                "' names a texture, a texture coordinate set or an alpha mode that does not exist");
        }
        if (material.texture != no_id && !description.textures[material.texture].alpha)
            return invalid("material '" + material.name + "' needs a texture with alpha");
        if (!is_sound(material.surface, description.textures.size()))
            return invalid("material '" + material.name +
                           "' has a number that is not finite or out of range, or a texture that "
                           "does not exist");
    }
    for (const LightDescription& light : description.lights) {
        if (!is_sound(light.light))
            return invalid("light '" + light.name +
                           "' has a number that is not finite or out of range");
    }
    for (const CameraDescription& camera : description.cameras) {
        const bool perspective =
            camera.ymag == 0 && camera.yfov > 0 && camera.yfov < std::numbers::pi_v<float>;
        const bool orthographic = camera.ymag > 0 && std::isfinite(camera.ymag) && camera.yfov == 0;
        if (!all_finite(camera.to_world.m) || !(perspective || orthographic) ||
            !(camera.aspect >= 0) || !std::isfinite(camera.aspect)) {
            return invalid("camera '" + camera.name +
                           "' needs a finite pose, an aspect >= 0, and either a field of view in "
                           "(0, pi) or a ymag above 0");
        }
    }
    return {};
}

bool is_sound(const Box& box) {
    return in_range(box.lower) && in_range(box.upper) && box.lower.x <= box.upper.x &&
           box.lower.y <= box.upper.y && box.lower.z <= box.upper.z;
}

/// Counts the primitives whose coordinates no tree can hold, for the message.
std::uint64_t count_far(const ObjectDescription& object) {
    std::uint64_t far = 0;
    for (const GeometryDescription& geometry : object.geometries) {
        for (std::size_t i = 0; i + 2 < geometry.indices.size(); i += 3) {
            const bool near = in_range(geometry.positions[geometry.indices[i]]) &&
                              in_range(geometry.positions[geometry.indices[i + 1]]) &&
                              in_range(geometry.positions[geometry.indices[i + 2]]);
            if (!near) ++far;
        }
    }
    for (const Box& box : object.record_bounds) {
        if (!is_sound(box)) ++far;
    }
    return far;
}

Result<void> check_geometry(const GeometryDescription& geometry, std::size_t materials,
                            const std::string& where) {
    const std::size_t vertices = geometry.positions.size();
    if (vertices >= no_id) return invalid(where + " has more than 2^32 vertices");
    if (geometry.indices.size() % 3 != 0 ||
        std::any_of(geometry.indices.begin(), geometry.indices.end(),
                    [&](std::uint32_t index) { return index >= vertices; })) {
        return invalid(where + " has an index beyond its vertices, or not three per triangle");
    }
    const auto is_per_vertex = [&](std::size_t size) { return size == 0 || size == vertices; };
    if (!is_per_vertex(geometry.texcoords[0].size()) ||
        !is_per_vertex(geometry.texcoords[1].size()) || geometry.colours.size() % 4 != 0 ||
        !is_per_vertex(geometry.colours.size() / 4) || !is_per_vertex(geometry.normals.size()) ||
        !is_per_vertex(geometry.tangents.size())) {
        return invalid(where + " has attributes that are not one per vertex");
    }
    if (!is_reference(geometry.material, materials)) {
        return invalid(where + " names material #" + std::to_string(geometry.material) +
                       ", which does not exist");
    }
    return {};
}

Result<void> check_object(const SceneDescription& description, std::uint32_t index) {
    const ObjectDescription& object = description.objects[index];
    const std::string name = "object " + object_label(description, index);
    for (std::size_t g = 0; g < object.geometries.size(); ++g) {
        auto checked = check_geometry(object.geometries[g], description.materials.size(),
                                      "geometry " + std::to_string(g) + " of " + name);
        if (!checked) return checked;
    }
    const std::size_t records = object.record_bounds.size();
    const bool sized = records == 0
                           ? object.records.empty()
                           : !object.record_type.empty() && object.records.size() >= records &&
                                 object.records.size() % records == 0;
    if (!sized) return invalid(name + " needs a record type and records of equal size");
    if (!object.record_colours.empty() &&
        (object.record_colours.size() != 4 * records || !object.geometries.empty()))
        return invalid(name +
                       " has colours that are not one per record, or geometries beside them");
    if (records != 0 && object.records.size() / records > record_size_max) {
        return invalid(name + " has records of more than " + std::to_string(record_size_max) +
                       " bytes");
    }
    if (records != 0 && own_triangles(object) != 0) {
        return invalid(name + " holds triangles and records: place one of them in a child object");
    }
    constexpr std::size_t entries_max = std::size_t{leaf_first_max} + 1;
    if (own_triangles(object) > 8 * entries_max || records > entries_max ||
        object.instances.size() > leaf_instance_max) {
        return fail(ErrorCode::limit_exceeded,
                    name + " has too many primitives for one tree: split it into several objects");
    }
    if (const std::uint64_t far = count_far(object); far != 0) {
        return invalid(name + " has " + std::to_string(far) +
                       " primitives with coordinates that are not finite or beyond 1e15");
    }
    return {};
}

/// Checks that nodes are in order, and that each node with placements is listed once.
Result<void> check_path_nodes(const SceneDescription& description) {
    const auto& nodes = description.path_nodes;
    std::uint64_t listed = 0;
    std::uint64_t placing = 0;
    for (std::size_t i = 0; i < nodes.size(); ++i) {
        if (nodes[i].parent > (i == 0 ? 0 : i - 1) ||
            (i > 1 && nodes[i].parent < nodes[i - 1].parent))
            return invalid("path node " + std::to_string(i) + " stands before its parent");
        listed += nodes[i].placements;
        if (nodes[i].placements != 0) ++placing;
    }
    std::vector<bool> seen(nodes.size(), false);
    for (const std::uint32_t node : description.placed_nodes) {
        if (node == 0 || node >= nodes.size() || nodes[node].placements == 0 || seen[node])
            return invalid("path node " + std::to_string(node) + " is no node with placements");
        seen[node] = true;
    }
    if (nodes.size() >= no_id || listed >= no_id)
        return fail(ErrorCode::limit_exceeded,
                    "the scene names more than 2^32 nodes or placements");
    if (placing != description.placed_nodes.size())
        return invalid("not every path node with placements is listed");
    return {};
}

/// Checks the names as Snapshot::open does in an arena.
Result<void> check_names(const SceneDescription& description) {
    const auto limit = [](const std::string& what, std::size_t most) {
        return fail(ErrorCode::limit_exceeded,
                    "the scene has " + what + " than " + std::to_string(most));
    };
    std::size_t longest = 0;
    const auto take = [&](const auto& list) {
        for (const auto& item : list) longest = std::max(longest, item.name.size());
    };
    std::set<std::string_view> record_types;
    take(description.objects);
    take(description.materials);
    take(description.cameras);
    take(description.lights);
    for (const ObjectDescription& object : description.objects) {
        take(object.instances);
        longest = std::max(longest, object.record_type.size());
        if (!object.record_type.empty()) record_types.insert(object.record_type);
    }
    for (const auto& [reason, count] : description.skipped)
        longest = std::max(longest, reason.size());
    for (const std::string& warning : description.warnings)
        longest = std::max(longest, warning.size());
    for (const std::string& variant : description.variants)
        longest = std::max(longest, variant.size());
    if (longest > scene_name_bytes_max)
        return limit("a name or warning of more bytes", scene_name_bytes_max);
    if (description.warnings.size() > scene_warnings_max)
        return limit("more warnings", scene_warnings_max);
    if (record_types.size() > scene_record_types_max)
        return limit("more record types", scene_record_types_max);
    if (description.cameras.size() > scene_cameras_max)
        return limit("more cameras", scene_cameras_max);
    if (description.lights.size() > scene_lights_max) return limit("more lights", scene_lights_max);
    return {};
}

}  // namespace

Result<void> check_description(const SceneDescription& description) {
    if (description.objects.size() >= no_id) {
        return fail(ErrorCode::limit_exceeded, "the scene has more than 2^32 objects");
    }
    if (auto checked = check_names(description); !checked) return checked;
    if (auto checked = check_path_nodes(description); !checked) return checked;
    if (auto checked = check_surfaces(description); !checked) return checked;
    for (std::uint32_t i = 0; i < description.objects.size(); ++i) {
        if (auto checked = check_object(description, i); !checked) return checked;
    }
    return {};
}

}  // namespace raynest
