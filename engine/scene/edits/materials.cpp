#include "engine/scene/edits/materials.h"

#include "engine/scene/edits/placed_sums.h"
#include "engine/scene/edits/shared_ways.h"

#include <fmt/format.h>

#include <charconv>
#include <span>

namespace raynest {
namespace {

std::span<const GeometryRecord> geometries_of(const SceneView& view, const ObjectRecord& object) {
    return {view.geometries + object.first_geometry, object.geometry_count};
}

bool is_opaque(const SceneView& view, std::uint32_t material) {
    return material == no_id || view.materials[material].alpha_mode == AlphaMode::opaque;
}

}  // namespace

Result<std::uint32_t> find_material(const SceneView& view, std::string_view text) {
    std::uint32_t found = no_id, count = 0;
    for (std::uint32_t i = 0; i < view.material_count; ++i) {
        if (view.names + view.materials[i].name != text) continue;
        found = i;
        ++count;
    }
    if (count == 1) return found;
    if (count > 1)
        return fail(ErrorCode::field_invalid,
                    fmt::format("names the material '{}', which {} have: give its number, as the "
                                "column material has it",
                                text, count));
    std::uint32_t number = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
    if (error == std::errc{} && end == text.data() + text.size() && number < view.material_count)
        return number;
    return fail(ErrorCode::field_invalid,
                fmt::format("names the material '{}': the scene has none of that name or number; "
                            "it has {}",
                            text, view.material_count));
}

std::vector<std::uint64_t> count_meshes(const SceneView& view) {
    return placed_sums(view, [](const ObjectRecord& object) -> std::uint64_t {
        return object.triangle_count != 0;
    });
}

std::vector<InstancePlace> meshes_of(const SceneView& view, const InstancePlace& place,
                                     const std::vector<std::uint64_t>& counts) {
    std::vector<InstancePlace> meshes;
    InstancePlace at = place;
    const auto look = [&](const auto& self, std::uint32_t number) -> void {
        if (counts[number] == 0) return;
        const ObjectRecord& object = view.objects[number];
        if (object.triangle_count != 0) meshes.push_back(at);
        for (std::uint32_t i = 0; i < object.instance_count; ++i) {
            at.below.push_back(i);
            self(self, view.instances[object.first_instance + i].object);
            at.below.pop_back();
        }
    };
    look(look, object_of(view, place));
    return meshes;
}

std::string_view why_not(const ShadingView& shading, const ObjectRecord& object,
                         std::uint32_t material) {
    const SceneView& view = *shading.scene;
    bool was_opaque = true, has_tangents = true;
    for (const GeometryRecord& geometry : geometries_of(view, object)) {
        was_opaque = was_opaque && is_opaque(view, geometry.material);
        has_tangents =
            has_tangents && shading.geometries[&geometry - view.geometries].tangents != no_offset;
    }
    if (!was_opaque || !is_opaque(view, material))
        return "rays may pass through it, or could before, and its tree was built for that: load "
               "the scene again";
    if (!has_tangents && needs_tangents(shading.surfaces[material]))
        return "it needs tangents, and the mesh has none: load the scene with that material";
    return "";
}

void set_material(EditedArena& arena, const ObjectRecord& object, std::uint32_t material) {
    for (std::uint32_t i = 0; i < object.geometry_count; ++i) {
        GeometryRecord& geometry = arena.geometry(object.first_geometry + i);
        geometry.material = material;
        arena.touch(geometry);
    }
}

}  // namespace raynest
