#include "engine/scene/snapshot.h"

#include "engine/geometry/hit.h"
#include "engine/scene/checks/arena_check.h"
#include "engine/scene/format.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <atomic>
#include <cstring>
#include <utility>

namespace raynest {
namespace {

using format::Section;

/// Smaller arenas are always copied as a whole.
constexpr std::size_t shared_bytes_min = std::size_t{1} << 20;
/// Pages are shared no longer once so many edits in a row had a spare: whole copies are faster, for
/// they lie on huge pages.
constexpr std::uint32_t unshared_copies_max = 100;

/// Counts the placements of each object below the root. The count of an empty group may overflow;
/// that of an object with primitives cannot (scene_paths_max).
std::vector<std::uint64_t> count_placements(const SceneView& scene) {
    std::vector<std::uint64_t> placements(scene.object_count, 0);
    placements[scene.root] = 1;
    for (std::uint32_t i = scene.object_count; i-- > 0;) {
        const ObjectRecord& object = scene.objects[i];
        for (std::uint32_t k = 0; k < object.instance_count; ++k) {
            std::uint64_t& sum = placements[scene.instances[object.first_instance + k].object];
            if (__builtin_add_overflow(sum, placements[i], &sum)) sum = ~std::uint64_t{0};
        }
    }
    return placements;
}

/// Counts the triangles below the root, each as often as it is placed.
Result<std::uint64_t> count_placed_triangles(const SceneView& scene,
                                             const std::vector<std::uint64_t>& placements) {
    std::uint64_t sum = 0;
    for (std::uint32_t i = 0; i < scene.object_count; ++i) {
        const std::uint64_t triangles = scene.objects[i].triangle_count;
        std::uint64_t placed = 0;
        if (triangles == 0) continue;
        if (__builtin_mul_overflow(triangles, placements[i], &placed) ||
            __builtin_add_overflow(sum, placed, &sum)) {
            return fail(ErrorCode::limit_exceeded, "the scene places more than 2^64 triangles");
        }
    }
    return sum;
}

std::vector<MaterialUse> count_material_uses(const SceneView& scene,
                                             const std::vector<std::uint64_t>& placements) {
    std::vector<MaterialUse> uses(scene.material_count);
    std::vector<std::uint32_t> last_user(scene.material_count, no_id);
    for (std::uint32_t i = 0; i < scene.object_count; ++i) {
        const ObjectRecord& object = scene.objects[i];
        for (std::uint32_t k = 0; k < object.geometry_count; ++k) {
            const GeometryRecord& geometry = scene.geometries[object.first_geometry + k];
            if (geometry.material == no_id || geometry.triangle_count == 0) continue;
            MaterialUse& use = uses[geometry.material];
            use.triangles += geometry.triangle_count;
            // The placements together have at most 2^63 paths, so no sum overflows.
            if (std::exchange(last_user[geometry.material], i) != i)
                use.placements += placements[i];
        }
    }
    return uses;
}

}  // namespace

Result<std::shared_ptr<const Snapshot>> Snapshot::open(BuiltArena built) {
    return reopen(std::move(built), {});
}

Result<std::shared_ptr<const Snapshot>> Snapshot::reopen(BuiltArena built, std::string digest) {
    Arena& arena = built.arena;
    const auto view = check_arena({arena.data(), arena.size()});
    if (!view) return tl::unexpected(view.error());
    const std::vector<std::uint64_t> placements = count_placements(*view);
    const auto placed = count_placed_triangles(*view, placements);
    if (!placed) return tl::unexpected(placed.error());

    const std::shared_ptr<Snapshot> snapshot(new Snapshot);
    const std::byte* const base = arena.data();
    auto uses = std::make_shared<std::vector<std::uint32_t>>(view->object_count);
    for (std::uint32_t i = 0; i < view->instance_count; ++i) ++(*uses)[view->instances[i].object];
    snapshot->uses_ = std::move(uses);
    snapshot->steps_ = std::make_shared<StepIndices>();
    snapshot->uids_ = std::make_shared<UidIndices>();
    snapshot->view_ = *view;
    snapshot->paths_ = format::path_table(base);
    ShadingView& shading = snapshot->shading_;
    shading.surfaces = format::section<SurfaceRecord>(base, Section::surfaces);
    shading.geometries = format::section<GeometryShading>(base, Section::geometry_shading);
    shading.levels = format::section<TextureLevels>(base, Section::texture_levels);
    shading.lights = format::section<LightRecord>(base, Section::lights);
    shading.light_count = static_cast<std::uint32_t>(format::section_size(base, Section::lights));

    SceneStatistics& s = snapshot->statistics_;
    for (std::uint32_t i = 0; i < view->object_count; ++i) {
        s.unique_triangles += view->objects[i].triangle_count;
        if (view->objects[i].has_own_primitives()) snapshot->meshes_.push_back({i, placements[i]});
    }
    snapshot->material_uses_ = count_material_uses(*view, placements);
    s.instanced_triangles = *placed;
    s.instances = view->objects[view->root].placement_count;
    s.levels = view->objects[view->root].levels;
    s.materials = view->material_count;
    s.mask_materials = static_cast<std::uint32_t>(
        std::count_if(view->materials, view->materials + view->material_count,
                      [](const MaterialRecord& m) { return m.alpha_mode == AlphaMode::mask; }));
    s.bytes = arena.size();
    s.nodes = format::section_size(base, Section::nodes);
    s.leaf_blocks = format::section_size(base, Section::blocks);
    const std::vector<TreeStatistics> trees = measure_each_tree(*view);
    s.trees.sah_cost = trees[view->root].sah_cost;
    for (const TreeStatistics& tree : trees) {
        s.trees.height = std::max(s.trees.height, tree.height);
        snapshot->trees_.costs.push_back(tree.sah_cost);
        snapshot->trees_.shares.push_back(tree.shares);
    }
    std::vector<TreeBuild>& trees_built = built.built;
    trees_built.resize(view->object_count);
    for (std::uint32_t i = 0; i < view->object_count; ++i)
        if (trees_built[i].area == 0)
            trees_built[i] = tree_build(view->objects[i].bounds, trees[i].shares);
    snapshot->trees_.built = std::make_shared<const std::vector<TreeBuild>>(std::move(trees_built));
    const auto& header = *reinterpret_cast<const format::Header*>(base);
    s.build = header.build;
    s.degenerate_triangles = header.degenerate_triangles;
    snapshot->origin_ = header.origin;
    shading.up = header.up;
    snapshot->bounds_ = header.bounds;
    s.build_seconds = built.build_seconds;
    s.edits = built.edits;
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
    s.variants.assign(s.warnings.end() - header.variants, s.warnings.end());
    s.warnings.resize(s.warnings.size() - header.variants);
    if (header.chosen_variant != 0) s.chosen_variant = s.variants[header.chosen_variant - 1U];
    append_names(Section::record_types, snapshot->record_types_);
    for (const std::string& type : snapshot->record_types_) {
        std::uint64_t& count = snapshot->record_counts_.emplace_back(0);
        for (std::uint32_t i = 0; i < view->object_count; ++i)
            if (view->objects[i].record_type == primitive_type(type.c_str()))
                count += view->objects[i].record_count;
    }

    auto name = raynest::arena_digest({base, arena.size()});
    if (!name) return tl::unexpected(name.error());
    snapshot->arena_id_ = std::move(*name);
    snapshot->arena_ = std::move(arena);
    shading.scene = &snapshot->view_;
    if (digest.empty()) {
        const auto& contents = snapshot->contents();
        if (!contents) return tl::unexpected(contents.error());
        digest = (*contents)->scene();
    }
    snapshot->digest_ = std::move(digest);
    return snapshot;
}

const Result<std::shared_ptr<const ContentDigests>>& Snapshot::contents() const {
    std::call_once(hashed_, [this] {
        if (contents_ && *contents_ == nullptr) contents_ = ContentDigests::of(checked());
    });
    return contents_;
}

Result<std::string> Snapshot::arena_digest() const {
    if (!is_edited_) return arena_id_;
    return raynest::arena_digest(bytes());
}

Result<std::shared_ptr<const Snapshot>> Snapshot::open_edited(BuiltArena built,
                                                              const Snapshot& before,
                                                              EditTraces traces) {
    const std::shared_ptr<Snapshot> snapshot(new Snapshot);
    const std::byte* const base = built.arena.data();
    const auto rebased = [&]<class T>(const T* in_before) {
        return reinterpret_cast<const T*>(
            base + (reinterpret_cast<const std::byte*>(in_before) - before.arena_.data()));
    };
    SceneView& view = snapshot->view_ = before.view_;
    view.nodes = rebased(view.nodes);
    view.blocks = rebased(view.blocks);
    view.records = rebased(view.records);
    view.objects = rebased(view.objects);
    view.instances = rebased(view.instances);
    view.instance_infos = rebased(view.instance_infos);
    view.geometries = rebased(view.geometries);
    view.materials = rebased(view.materials);
    view.textures = rebased(view.textures);
    view.cameras = rebased(view.cameras);
    view.attributes = rebased(view.attributes);
    view.names = rebased(view.names);
    ShadingView& shading = snapshot->shading_ = before.shading_;
    shading.surfaces = rebased(shading.surfaces);
    shading.geometries = rebased(shading.geometries);
    shading.levels = rebased(shading.levels);
    shading.lights = rebased(shading.lights);
    shading.scene = &view;
    snapshot->paths_ = format::path_table(base);
    snapshot->origin_ = before.origin_;
    snapshot->bounds_ = reinterpret_cast<const format::Header*>(base)->bounds;
    snapshot->statistics_ = before.statistics_;
    snapshot->trees_ = std::move(traces.trees);
    snapshot->uses_ = before.uses_;
    snapshot->steps_ = before.steps_;
    snapshot->uids_ = traces.has_new_uids ? std::make_shared<UidIndices>() : before.uids_;
    snapshot->statistics_.trees.sah_cost = snapshot->tree_costs()[view.root];
    snapshot->statistics_.edits = built.edits;
    snapshot->statistics_.degenerate_triangles =
        reinterpret_cast<const format::Header*>(base)->degenerate_triangles;
    snapshot->record_types_ = before.record_types_;
    snapshot->record_counts_ = before.record_counts_;
    snapshot->meshes_ = before.meshes_;
    snapshot->material_uses_ = before.material_uses_;
    ArenaSharing& sharing = snapshot->sharing_ = std::move(traces.sharing);
    if (sharing.shared)
        sharing.apart.add(traces.changed.pages);
    else
        sharing.apart = {};
    auto& edits_made = snapshot->edits_;
    edits_made.push_back(std::make_shared<const EditedFrom>(
        EditedFrom{before.arena_id_, std::move(traces.changed)}));
    edits_made.insert(edits_made.end(), before.edits_.begin(), before.edits_.end());
    if (edits_made.size() > edits_remembered) edits_made.pop_back();
    snapshot->arena_ = std::move(built.arena);
    static std::atomic<std::uint64_t> edits = 0;
    snapshot->is_edited_ = true;
    snapshot->arena_id_ = "edit " + std::to_string(++edits);
    const auto& contents = before.contents();
    if (!contents) return tl::unexpected(contents.error());
    snapshot->contents_ = (*contents)->after(snapshot->checked(), traces.content);
    if (!snapshot->contents_) return tl::unexpected(snapshot->contents_.error());
    snapshot->digest_ = (*snapshot->contents_)->scene();
    return snapshot;
}

std::shared_ptr<const Snapshot> Snapshot::framed_as(const Snapshot& scene,
                                                    std::shared_ptr<const Snapshot> made) {
    const_cast<Snapshot&>(*made).framed_ = scene.framed_bounds();
    return made;
}

std::optional<EditedFrom> Snapshot::edited_from(
    const std::function<bool(const std::string&)>& is_wanted) const {
    EditedFrom from;
    for (const auto& edit : edits_) {
        from.changed.add(edit->changed);
        if (!is_wanted(edit->arena_id)) continue;
        from.arena_id = edit->arena_id;
        return from;
    }
    return std::nullopt;
}

std::span<const std::byte> Snapshot::motion_bytes() const {
    return {format::section<std::byte>(arena_.data(), Section::motion),
            format::section_size(arena_.data(), Section::motion)};
}

Arena Snapshot::copy_arena() const {
    constexpr std::size_t piece = std::size_t{1} << 20;
    Arena arena(arena_.size());
    tbb::parallel_for(std::size_t{0}, (arena.size() + piece - 1) / piece, [&](std::size_t i) {
        std::memcpy(arena.data() + i * piece, arena_.data() + i * piece,
                    std::min(piece, arena.size() - i * piece));
    });
    return arena;
}

TreeKnowledge Snapshot::trees_to_edit() const {
    const std::scoped_lock lock(edit_mutex_);
    auto extents = std::exchange(trees_.extents, nullptr);
    return {trees_.links, trees_.costs, trees_.shares,
            extents ? extents : std::make_shared<KnownBox>(), trees_.built};
}

std::shared_ptr<const SharedPages> Snapshot::share() const {
    const std::scoped_lock lock(edit_mutex_);
    auto shared = shareable_.lock();
    if (!shared) shareable_ = shared = std::make_shared<const SharedPages>(bytes());
    return shared;
}

ArenaCopy Snapshot::copy_to_edit(const Snapshot& scene, std::shared_ptr<const Snapshot> spare) {
    const std::size_t bytes = scene.arena_.size();
    ArenaCopy copy{{}, scene.sharing_};
    ArenaSharing& sharing = copy.sharing;
    ++sharing.unshared;
    // Nobody else refers to it, and it is not used again.
    const bool is_free = spare != nullptr && spare.use_count() == 1 && !scene.edits_.empty() &&
                         spare->arena_id_ == scene.edits_.front()->arena_id &&
                         spare->arena_.size() == bytes;
    if (is_free && sharing.unshared > unshared_copies_max)
        sharing = {nullptr, {}, 0, sharing.unshared};
    const auto copy_pages = [&](const PageSet& pages) {
        pages.for_each([&](std::size_t first) {
            std::memcpy(copy.arena.data() + first, scene.arena_.data() + first,
                        std::min(PageSet::page_bytes, bytes - first));
        });
    };
    if (is_free && (!spare->arena_.is_shared() || spare->shared() == sharing.shared)) {
        copy.arena = std::move(const_cast<Snapshot&>(*spare).arena_);
        copy_pages(scene.edits_.front()->changed.pages);
        return copy;
    }
    // The difference grows with each edit elsewhere, until copies of it have cost a whole one.
    const std::size_t apart = sharing.apart.bytes();
    const std::size_t changed =
        scene.edits_.empty() ? 0 : scene.edits_.front()->changed.pages.bytes();
    const bool is_near = sharing.shared != nullptr && apart <= bytes / 4 &&
                         (sharing.copied <= bytes || apart <= 8 * changed);
    // A scene that is edited for the first time gives its own memory to the edit after this one.
    const bool is_large = scene.is_edited_ && bytes >= shared_bytes_min;
    if (is_free || !is_large || (!is_near && changed > bytes / 8)) {
        copy.arena = scene.copy_arena();
        return copy;
    }
    if (!is_near) sharing = {scene.share(), PageSet(bytes)};
    sharing.copied += sharing.apart.bytes();
    sharing.unshared = 0;
    copy.arena = Arena(*sharing.shared);
    copy_pages(sharing.apart);
    return copy;
}

}  // namespace raynest
