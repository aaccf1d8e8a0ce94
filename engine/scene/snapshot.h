// An immutable scene: one relocatable, versioned arena and the view that kernels read.
//
// The arena is a header, a section table and the sections of geometry/views.h, 64-byte aligned, no
// pointers. It is what the import child writes, what the daemon maps, and what a cache file or a
// CUDA worker would read. scene/FORMAT.md draws it.
#pragma once

#include "engine/bvh/pages.h"
#include "engine/geometry/path.h"
#include "engine/geometry/views.h"
#include "engine/result.h"
#include "engine/scene/content_digest.h"
#include "engine/scene/description.h"
#include "engine/scene/lists/step_index.h"
#include "engine/scene/lists/uid_index.h"
#include "engine/scene/page_set.h"
#include "engine/scene/tree_knowledge.h"
#include "engine/scene/tree_statistics.h"
#include "engine/shading/records.h"

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace raynest {

/// Limits on what may become a snapshot.
inline constexpr std::uint32_t scene_depth_max = 32;
inline constexpr float coordinate_max = 1e15F;
/// True if each coordinate is within coordinate_max; false for NaN.
[[nodiscard]] inline bool is_origin(const WorldPoint& point) {
    constexpr double most{coordinate_max};
    const auto fits = [](double x) { return x >= -most && x <= most; };
    return fits(point[0]) && fits(point[1]) && fits(point[2]);
}
inline constexpr std::uint64_t scene_paths_max = 1ULL << 63;
inline constexpr std::uint32_t record_size_max = 4096;  ///< bytes of one record
inline constexpr std::uint32_t texture_side_max =
    16384;  ///< pixels; an RGBA plane stays below 2^31
/// Limits on the contents of an arena that are copied or looked up by name.
inline constexpr std::uint32_t scene_name_bytes_max = 8192;  ///< for any name or warning
inline constexpr std::uint32_t scene_warnings_max = 1024;    ///< names of variants counted
inline constexpr std::uint32_t scene_skips_max = 1024;       ///< reasons
inline constexpr std::uint32_t scene_record_types_max = 256;
inline constexpr std::uint32_t scene_cameras_max = 65536;
inline constexpr std::uint32_t scene_lights_max = 65536;

/// The memory of a snapshot.
using Arena = Pages;

/// The work of edits on trees (scene/edits/edit.h). Not in the arena.
struct EditStatistics {
    std::uint64_t refits = 0;    ///< edits since a tree was built again
    std::uint64_t rebuilds = 0;  ///< trees that were built again
    /// What the last edit looked at: nodes above what changed, and nodes and instances for the
    /// scene's box.
    std::uint64_t nodes = 0;
};

/// The numbers that `info` prints; instanced_triangles and instances count placements.
struct SceneStatistics {
    std::uint64_t unique_triangles = 0;
    std::uint64_t instanced_triangles = 0;
    /// Triangles that nothing can hit, each once; the other counts include them.
    std::uint64_t degenerate_triangles = 0;
    std::uint64_t instances = 0;  ///< leaf placements: paths to objects with own primitives
    std::uint32_t levels = 0;
    std::uint32_t materials = 0;
    std::uint32_t mask_materials = 0;  ///< alphaMode MASK; SceneView::masked_materials adds BLEND
    std::uint64_t bytes = 0;
    std::uint64_t nodes = 0;
    std::uint64_t leaf_blocks = 0;
    TreeStatistics trees;
    BuildQuality build = BuildQuality::medium;
    /// From triangles to finished trees and leaf blocks, where this process or its import child did
    /// that; 0 for an arena from elsewhere. Not in the arena: equal scenes have equal bytes.
    double build_seconds = 0;
    EditStatistics edits = {};
    std::vector<std::string> cameras;
    std::map<std::string, std::uint64_t> skipped;
    std::vector<std::string> warnings;
    std::vector<std::string> variants;  ///< SceneDescription::variants
    std::string chosen_variant;         ///< one of them, or ""
};

/// An object with primitives of its own, and how often it is placed.
struct MeshUse {
    std::uint32_t object = 0;
    std::uint64_t placements = 0;
};

/// Triangles of all meshes that use a material, each once, and the placements of those meshes.
struct MaterialUse {
    std::uint64_t triangles = 0;
    std::uint64_t placements = 0;
};

/// An arena as a build leaves it: not checked, and without a digest. An import child hands it over
/// like this, because whoever opens it has to do both anyway.
struct BuiltArena {
    Arena arena;
    double build_seconds = 0;  ///< SceneStatistics::build_seconds
    EditStatistics edits = {};
    std::vector<TreeBuild> built = {};  ///< by object; empty, or without an area: built just now
};

/// Builds every object's tree and lays the arena out. Fails with scene_invalid or limit_exceeded,
/// naming the object. Coordinates beyond 1e15 and non-finite ones are refused with a count.
/// Singular instances are left out: skipped["singular_instances"] counts the leaf placements lost
/// with them, "singular_instance_triangles" the triangles of those, and "singular_unique_triangles"
/// the triangles that nothing else places. Objects that the root does not reach are left out.
/// Throws std::bad_alloc.
Result<BuiltArena> build_arena(const SceneDescription& description);

/// The memory that an arena has in common with others.
struct ArenaSharing {
    std::shared_ptr<const SharedPages> shared;  ///< what copies may begin with; or null
    PageSet apart;                              ///< the pages in which the arena differs from it
    std::uint64_t copied = 0;                   ///< bytes of such pages in all copies so far
    std::uint32_t unshared = 0;                 ///< copies since the last one that began with it
};

/// An arena that an edit changes: a copy of that before.
struct ArenaCopy {
    Arena arena;
    ArenaSharing sharing;
};

/// A scene that another was edited from: both arenas have one layout.
struct EditedFrom {
    std::string arena_id;
    ArenaChanges changed;
};
/// How many edits back a scene knows what it was edited from.
inline constexpr std::size_t edits_remembered = 64;

/// The differences of an edited arena from the one before.
struct EditTraces {
    ArenaSharing sharing;  ///< the copy's, before the edit
    ArenaChanges changed;  ///< by the edit
    TreeKnowledge trees;
    TouchedObjects content;
    bool has_new_uids = false;
};

class Snapshot {
public:
    /// build_arena, then open: an arena of this process is checked like any other.
    static Result<std::shared_ptr<const Snapshot>> build(const SceneDescription& description);

    /// Takes an arena that came from a cache or an import child. Every section bound, child word,
    /// index and offset is checked once, so that traversal need not check any.
    static Result<std::shared_ptr<const Snapshot>> open(BuiltArena built);

    /// The same for content that was open before, whose digest() was `digest`: an edit is the first
    /// to hash it again. An empty one is not known.
    static Result<std::shared_ptr<const Snapshot>> reopen(BuiltArena built, std::string digest);

    /// Opens an arena that edit_scene() made of `before`, laid out as that is. It is not checked
    /// again.
    static Result<std::shared_ptr<const Snapshot>> open_edited(BuiltArena built,
                                                               const Snapshot& before,
                                                               EditTraces traces);
    /// Returns a copy of `scene`'s arena. It is made in the memory of `spare` if that is the scene
    /// before the last edit of `scene` and nobody else refers to it: then only what the edit
    /// changed is copied. Where others hold the scenes before, a large scene and its copies share
    /// the pages that no edit since has changed. Throws std::bad_alloc.
    static ArenaCopy copy_to_edit(const Snapshot& scene, std::shared_ptr<const Snapshot> spare);
    [[nodiscard]] Arena copy_arena() const;

    [[nodiscard]] const SceneView& view() const { return view_; }
    /// The same scene with materials, normals and lights, for integrators.
    [[nodiscard]] const ShadingView& shading() const { return shading_; }
    [[nodiscard]] const PathTable& paths() const { return paths_; }
    [[nodiscard]] const SceneStatistics& statistics() const { return statistics_; }
    [[nodiscard]] std::span<const std::byte> bytes() const {
        return {arena_.data(), arena_.size()};
    }
    /// Memory of the arena beside shared().
    [[nodiscard]] std::size_t own_bytes() const {
        return arena_.is_shared() ? sharing_.apart.bytes() : arena_.size();
    }
    /// Memory that it has in common with other epochs; or null.
    [[nodiscard]] const std::shared_ptr<const SharedPages>& shared() const {
        return sharing_.shared;
    }
    /// Bytes of the arena on huge pages (Pages::huge_bytes).
    [[nodiscard]] std::size_t huge_bytes() const { return arena_.huge_bytes(); }
    /// The tables of its animations (motion/motion.h); empty: nothing moves by itself.
    [[nodiscard]] std::span<const std::byte> motion_bytes() const;
    /// World coordinates less this are those of the view, of rays and of answers.
    [[nodiscard]] const WorldPoint& origin() const { return origin_; }
    [[nodiscard]] UpAxis up() const { return shading_.up; }
    /// The box of all vertices as they are placed, and of records' boxes; trees have larger ones.
    [[nodiscard]] const Box& bounds() const { return bounds_; }
    /// The box that a camera of framing() shows: bounds(), but of a scene at a moment those that it has
    /// without one, so that the camera of a film stands still.
    [[nodiscard]] const Box& framed_bounds() const { return framed_ ? *framed_ : bounds_; }
    /// Returns `made`, which nobody else has yet, with the framed_bounds() of `scene`.
    static std::shared_ptr<const Snapshot> framed_as(const Snapshot& scene,
                                                     std::shared_ptr<const Snapshot> made);
    /// The scene's identity, as 64 hex digits (scene/content_digest.h): equal content, equal hits.
    [[nodiscard]] const std::string& digest() const { return digest_; }
    /// Equal for equal arenas, trees included: memory may be shared by it. It is the arena's digest
    /// (scene/digest.h), but for a scene that was edited: that one has a name of its own.
    [[nodiscard]] const std::string& arena_id() const { return arena_id_; }
    /// Returns the latest of the scenes that this one was edited from, at most edits_remembered
    /// edits ago, whose arena_id() is wanted; nothing if none is.
    [[nodiscard]] std::optional<EditedFrom> edited_from(
        const std::function<bool(const std::string&)>& is_wanted) const;
    /// Returns the arena's digest, and takes the time to hash it where an edit has made it.
    [[nodiscard]] Result<std::string> arena_digest() const;
    /// Names of the primitive types in use beside triangles ("sphere").
    [[nodiscard]] const std::vector<std::string>& record_types() const { return record_types_; }
    /// Records of each of them, every object once.
    [[nodiscard]] const std::vector<std::uint64_t>& record_counts() const { return record_counts_; }
    [[nodiscard]] const std::vector<MeshUse>& meshes() const { return meshes_; }
    /// Expected costs of the objects' trees (TreeStatistics::sah_cost).
    [[nodiscard]] const std::vector<double>& tree_costs() const { return trees_.costs; }
    /// By object.
    [[nodiscard]] const std::vector<TreeBuild>& trees_built() const { return *trees_.built; }
    /// Returns what an edit of this scene begins with. The extents go to the first one that asks.
    [[nodiscard]] TreeKnowledge trees_to_edit() const;
    /// Those of the steps below objects, in a scene with nodes below these.
    [[nodiscard]] StepIndices& steps() const { return *steps_; }
    /// Those of the user ids below objects, which nodes do not have.
    [[nodiscard]] UidIndices& uids() const { return *uids_; }
    /// How often instances place each object.
    [[nodiscard]] const std::vector<std::uint32_t>& uses() const { return *uses_; }
    /// One per material.
    [[nodiscard]] const std::vector<MaterialUse>& material_uses() const { return material_uses_; }

private:
    Snapshot() = default;
    [[nodiscard]] CheckedArena checked() const { return {bytes(), view_, shading_}; }
    /// Returns the arena for copies to begin with.
    [[nodiscard]] std::shared_ptr<const SharedPages> share() const;
    /// Hashes the content unless that was done.
    [[nodiscard]] const Result<std::shared_ptr<const ContentDigests>>& contents() const;
    Arena arena_;
    SceneView view_;
    ShadingView shading_;
    PathTable paths_;
    WorldPoint origin_{};
    Box bounds_;
    std::optional<Box> framed_;
    SceneStatistics statistics_;
    mutable TreeKnowledge trees_;
    // Edits in place change none of these, but those of user ids the last one.
    std::shared_ptr<const std::vector<std::uint32_t>> uses_;
    std::shared_ptr<StepIndices> steps_;
    std::shared_ptr<UidIndices> uids_;
    std::string digest_;
    std::string arena_id_;
    bool is_edited_ = false;
    mutable std::once_flag hashed_;
    mutable Result<std::shared_ptr<const ContentDigests>> contents_;  ///< null until it is hashed
    /// The last edits, newest first, each with the differences between its two scenes
    std::vector<std::shared_ptr<const EditedFrom>> edits_;
    ArenaSharing sharing_;
    mutable std::mutex edit_mutex_;                       ///< of shareable_ and trees_.extents
    mutable std::weak_ptr<const SharedPages> shareable_;  ///< this arena, for copies of it
    std::vector<std::string> record_types_;
    std::vector<std::uint64_t> record_counts_;
    std::vector<MeshUse> meshes_;
    std::vector<MaterialUse> material_uses_;
};

/// Limits on texts of paths: what has more steps or bytes keeps its end, behind a step "...".
inline constexpr std::size_t path_step_bytes_max = 240;  ///< for a name, before its number
inline constexpr std::size_t path_steps_max = 480;
inline constexpr std::size_t path_text_bytes_max = 4000;

/// One step of an expanded path id, outermost first.
struct PathStep {
    std::uint32_t instance = 0;  ///< its place among the steps of its parent, as declared
    std::uint32_t uid = 0;
    std::uint32_t node = no_id;  ///< index of the node in the file, where that has nodes
    std::string name;            ///< spelled as in path texts, with its number
};

/// Expands a flat path id; fails with scene_invalid when the scene has no such path.
Result<std::vector<PathStep>> expand_path(const Snapshot& scene, std::uint64_t path);

/// Names joined by '/', e.g. "stand#3/tree-12/leaves".
std::string path_name(const std::vector<PathStep>& steps);

/// The path of such a text, the other way round; fails with scene_invalid and what there is
/// instead.
Result<std::uint64_t> find_path(const Snapshot& scene, std::string_view text);

/// A name as path texts spell it: '/', '#', '%', '*' and the first digit of a name of digits alone are
/// percent-encoded, and it is cut after path_step_bytes_max.
std::string path_step_text(std::string_view name);
/// The same with its number behind it; no_id is none.
std::string numbered(std::string_view step, std::uint32_t number);

}  // namespace raynest
