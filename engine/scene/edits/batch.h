// Collects the changes of one edit in their order. Placements are computed in double and rounded
// once.
#pragma once

#include "engine/math/matrix.h"
#include "engine/result.h"
#include "engine/scene/edits/edit.h"
#include "engine/scene/edits/edit_guard.h"
#include "engine/scene/snapshot.h"

#include <cstdint>
#include <map>
#include <memory>
#include <set>
#include <span>
#include <string>
#include <utility>
#include <vector>

namespace raynest {

/// The space that a matrix is given in.
enum class EditFrame : std::uint32_t {
    world,
    parent,  ///< the frame of the object that places the instance
    own,     ///< the frame of the instance's object; to move alone
};

/// Not thread-safe. `scene` must outlive it.
class EditBatch {
public:
    explicit EditBatch(const Snapshot& scene, EditGuard guard = {})
        : scene_(scene),
          guard_(std::move(guard)) {}

    /// Asks the guard for the memory of so many more changes, and of changes() of all of them. To be
    /// called before them. Fails as the guard does.
    Result<void> expect(std::uint64_t more);

    /// Moves an instance that the scene has, on top of what has been said of it and of those above
    /// it.
    void move(const InstancePlace& place, const Matrix& by, EditFrame frame);
    /// Places it: `to` maps the object's own coordinates to those of the frame, which is not `own`.
    /// Fails with field_invalid in a scene with an origin, whose objects have coordinates of their
    /// own.
    Result<void> place(const InstancePlace& place, const Matrix& to, EditFrame frame);
    void set_mask(const InstancePlace& place, std::uint32_t mask) { masks_[place] = mask; }
    /// Gives an instance, and all within it, a user id, in place of what has been said of those.
    void set_uid(const InstancePlace& place, std::uint32_t uid);
    /// Gives the object of an instance, or the one that alone stands in it, other vertices and, for
    /// each of them or for none, normals, which must outlive the batch and its changes. Fails with field_invalid for normals that are
    /// not finite, or of a mesh that has none.
    Result<void> set_vertices(const InstancePlace& place, const NewVertices& vertices);
    /// Gives the triangles of an instance, and of all within it, a material of the scene. Fails with
    /// field_invalid if there are none, with limit_exceeded beyond edited_meshes_max, and as
    /// expect().
    Result<void> set_material(const InstancePlace& place, std::uint32_t material);
    /// Fails with field_invalid for an instance within another one.
    Result<void> remove(const InstancePlace& place);
    /// Adds a placement of a scene, from its world to this scene's. Placements of one key share the
    /// name and are numbered in their order.
    void add(std::uint32_t key, std::shared_ptr<const Snapshot> scene, const std::string& name,
             const Matrix& to_world, std::uint32_t mask);

    /// How many instances are named or added.
    [[nodiscard]] std::size_t size() const;
    [[nodiscard]] SceneChanges changes() const;

private:
    [[nodiscard]] Matrix placement_of(const InstancePlace& place) const;
    [[nodiscard]] Matrix above(const InstancePlace& place) const;

    const Snapshot& scene_;
    const EditGuard guard_;
    std::uint64_t expected_ = 0;              ///< changes that the guard has granted
    std::vector<std::uint64_t> mesh_counts_;  ///< count_meshes(), once it is needed
    std::map<InstancePlace, Matrix> placements_;
    std::map<InstancePlace, std::uint32_t> masks_;
    std::map<InstancePlace, NewVertices> vertices_;
    std::map<InstancePlace, std::uint32_t> uids_;
    std::map<InstancePlace, std::uint32_t> materials_;
    std::set<std::uint32_t> removed_;
    std::map<std::uint32_t, AddedScene> added_;
};

}  // namespace raynest
