#include "engine/scene/snapshot.h"

#include "engine/geometry/hit.h"
#include "engine/scene/arena_check.h"
#include "engine/scene/format.h"
#include "engine/scene/hash.h"

#include <algorithm>
#include <utility>

namespace raynest {
namespace {

using format::Section;

/// Triangles below the root, each as often as it is placed.
Result<std::uint64_t> count_placed_triangles(const SceneView& scene) {
    std::vector<std::uint64_t> below(scene.object_count);
    for (std::uint32_t i = 0; i < scene.object_count; ++i) {
        const ObjectRecord& object = scene.objects[i];
        below[i] = object.triangle_count;
        for (std::uint32_t k = 0; k < object.instance_count; ++k) {
            const InstanceRecord& instance = scene.instances[object.first_instance + k];
            if (__builtin_add_overflow(below[i], below[instance.object], &below[i])) {
                return fail(ErrorCode::limit_exceeded, "the scene places more than 2^64 triangles");
            }
        }
    }
    return below[scene.root];
}

}  // namespace

Result<std::shared_ptr<const Snapshot>> Snapshot::open(Arena arena, double build_seconds) {
    const auto view = check_arena({arena.data(), arena.size()});
    if (!view) return tl::unexpected(view.error());
    const auto placed = count_placed_triangles(*view);
    if (!placed) return tl::unexpected(placed.error());

    const std::shared_ptr<Snapshot> snapshot(new Snapshot);
    const std::byte* const base = arena.data();
    snapshot->view_ = *view;
    snapshot->paths_ = format::path_table(base);

    SceneStatistics& s = snapshot->statistics_;
    for (std::uint32_t i = 0; i < view->object_count; ++i) {
        s.unique_triangles += view->objects[i].triangle_count;
    }
    s.instanced_triangles = *placed;
    s.instances = view->objects[view->root].leaves;
    s.levels = view->objects[view->root].levels;
    s.materials = view->material_count;
    s.mask_materials = static_cast<std::uint32_t>(
        std::count_if(view->materials, view->materials + view->material_count,
                      [](const MaterialRecord& m) { return m.alpha_mode == AlphaMode::mask; }));
    s.bytes = arena.size();
    s.nodes = format::section_size(base, Section::nodes);
    s.leaf_blocks = format::section_size(base, Section::blocks);
    s.trees = measure_trees(*view);
    const auto& header = *reinterpret_cast<const format::Header*>(base);
    s.build = header.build;
    s.degenerate_triangles = header.degenerate_triangles;
    snapshot->origin_ = header.origin;
    s.build_seconds = build_seconds;
    for (std::uint32_t i = 0; i < view->camera_count; ++i) {
        s.cameras.emplace_back(view->names + view->cameras[i].name);
    }
    const auto* skips = format::section<format::SkipRecord>(base, Section::skips);
    for (std::uint64_t i = 0; i < format::section_size(base, Section::skips); ++i) {
        s.skipped[view->names + skips[i].reason] += skips[i].count;
    }
    const auto append_names = [&](Section section, std::vector<std::string>& out) {
        const auto* names = format::section<format::NameOffset>(base, section);
        for (std::uint64_t i = 0; i < format::section_size(base, section); ++i) {
            out.emplace_back(view->names + names[i]);
        }
    };
    append_names(Section::warnings, s.warnings);
    append_names(Section::record_types, snapshot->record_types_);

    snapshot->hash_ = content_hash({base, arena.size()});
    snapshot->arena_ = std::move(arena);
    return snapshot;
}

}  // namespace raynest
