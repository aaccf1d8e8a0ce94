// The contents of an arena out of parts of other scenes, before it is written.
#pragma once

#include "engine/scene/content.h"
#include "engine/scene/farthest.h"
#include "engine/scene/snapshot.h"

#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <span>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

namespace raynest {

/// Collects the contents of an arena from those of other scenes, which must outlive it. Objects
/// come out children first. Not thread-safe.
class LinkedContent {
public:
    /// Begins with all that a scene has beside objects: its materials, cameras, lights, names,
    /// warnings.
    explicit LinkedContent(const Snapshot& base);

    /// Another scene to take objects from. Its materials come with them.
    std::size_t add_scene(const Snapshot& scene);

    /// Returns the new index of an object, which is copied with all below it at the first call. An
    /// object that is there already, byte for byte, is not copied again, unless it is of the base.
    std::uint32_t keep(std::size_t scene, std::uint32_t object);
    /// Copies an object once more, whose instances place these objects.
    std::uint32_t copy(std::size_t scene, std::uint32_t object,
                       const std::vector<std::uint32_t>& children);

    /// An instance of a new root.
    struct Placed {
        std::uint32_t object;  ///< new index
        Transform to_parent;
        std::uint32_t mask = 0xFFFFFFFFU;  ///< InstanceInfo::mask
        std::uint32_t uid = 0;
        std::uint32_t name = 0;  ///< offset in the new names
        std::uint32_t number = no_id;
    };
    /// Ends with a root of these instances, and builds its tree. The checks of link_scenes().
    Result<void> add_root(std::uint32_t name, std::vector<Placed> instances);

    [[nodiscard]] Content& content() { return content_; }
    /// Offset of a name of a scene in the new names.
    std::uint32_t name(const Snapshot& scene, std::uint32_t offset);
    /// The objects' trees as they were built; the new root's has nothing yet.
    [[nodiscard]] std::vector<TreeBuild> trees_built() const;

    /// Writes the arena. `has_nodes` tells whether path nodes name the paths; else instances do.
    Result<Arena> write(bool has_nodes);

    // The trees of the new objects, for farthest.h.
    [[nodiscard]] ObjectTree tree(std::uint32_t object) const;
    [[nodiscard]] TreePlacement placement(std::uint32_t object, std::uint32_t place) const;
    [[nodiscard]] double padding(std::uint32_t object, std::uint32_t place) const;
    [[nodiscard]] double farthest_in_leaf(std::uint32_t object, std::uint32_t leaf,
                                          const Reach& reach, double most) const;

private:
    struct Scene {
        const Snapshot* snapshot;
        std::vector<std::uint32_t> objects;    ///< new indices, no_id: not copied
        std::vector<std::uint32_t> materials;  ///< new indices
        std::unordered_map<std::uint64_t, std::uint64_t> runs =
            {};                                   ///< for attributes: old -> new offset
        std::vector<std::uint32_t> numbers = {};  ///< its instances', as in section 17
    };
    struct Origin {
        std::size_t scene;
        std::uint32_t object;
    };

    /// The instances of an object, as they will be written.
    struct Instances {
        std::vector<InstanceRecord> records;
        std::vector<InstanceInfo> infos;
        std::vector<std::uint32_t> numbers;
    };

    std::span<const std::byte> run(const Scene& scene, std::uint64_t offset,
                                   std::uint64_t bytes) const;
    std::uint64_t add_run(Scene& scene, std::uint64_t offset, std::uint64_t bytes);
    void add_materials(Scene& scene, bool is_base);
    void add_geometries(Scene& scene, const ObjectRecord& object);
    std::uint32_t add_texture(Scene& scene, std::uint32_t texture);
    std::uint32_t add_object(std::size_t scene, std::uint32_t object,
                             const std::vector<std::uint32_t>& children, bool may_share);
    /// The union of the masks below an object, by its new index.
    [[nodiscard]] std::uint32_t mask_of(std::uint32_t object) const;
    [[nodiscard]] bool is_same(std::uint32_t known, const Scene& scene, const ObjectRecord& object,
                               const Instances& instances) const;

    Content content_;
    std::deque<Scene> scenes_;
    std::vector<Origin> origins_;         ///< the objects'; the new root has none
    std::vector<std::uint32_t> numbers_;  ///< per instance
    std::map<std::string, std::vector<std::uint32_t>> alike_;  ///< objects that may be the same
    std::map<std::string, std::uint32_t> known_materials_;
    std::map<std::string, std::vector<std::pair<std::uint32_t, std::span<const std::byte>>>>
        known_textures_;
    Tree root_tree_;
    std::uint64_t nodes_ = 0, blocks_ = 0, record_bytes_ = 0;
};

}  // namespace raynest
