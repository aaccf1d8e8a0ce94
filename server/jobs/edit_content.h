// The rows of an edit, and how they are kept for the time after a restart.
#pragma once

#include "engine/scene/edits/batch.h"
#include "engine/scene/edits/edit_guard.h"
#include "protocol/edit_row.h"
#include "protocol/wire.h"
#include "server/ground/errors.h"
#include "server/store/manifest.h"
#include "server/store/named_scene.h"

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

namespace raynest::server {

using protocol::EditRow;

/// The rows say what changes; these lists say what they name.
struct EditContent {
    std::vector<std::string> targets;
    /// A scene of which placements are added, with its share of --memory.
    struct Source {
        std::shared_ptr<const HeldScene> held;
        std::string name;                          ///< in paths
        std::shared_ptr<const void> reading = {};  ///< as in NamedScene
    };
    std::vector<Source> sources;
    std::uint32_t rows = 0;
    std::vector<std::uint32_t> vertex_counts;  ///< for the meshes behind the rows
    /// For each of these the number of its normals: as many, or 0. Empty: 0.
    std::vector<std::uint32_t> normal_counts;
    std::vector<std::string> materials;         ///< names or numbers (find_material())
    [[nodiscard]] std::uint64_t bytes() const;  ///< bytes of the rows, vertices and normals
    /// Takes the lists of a valid message, except for `sources`.
    static EditContent of(const wire::Edit& message);
};

/// Reads all rows into the batch, whose scene is called `name`. `bytes` are the rows, vertices and
/// normals, aligned as a float is, and outlive the batch. Fails with INVALID_FIELD and the row, with
/// CANCELLED, and as the guard does, which is also that of the batch.
Reply<void> read_edit(EditBatch& batch, const Snapshot& scene, const std::string& name,
                      const EditContent& content, std::span<const std::byte> bytes,
                      const EditGuard& guard);

/// Says in a few words what an edit changes, for people: "moved car-3, car-4 and 7 more; removed
/// tree-2". read_edit() has found the rows right.
[[nodiscard]] std::string edit_summary(const Snapshot& scene, const EditContent& content,
                                       std::span<const std::byte> bytes);
/// Returns an edit that adds no scenes as replay_edits() reads it.
[[nodiscard]] Reply<std::vector<std::byte>> kept_change(const EditContent& content,
                                                        std::span<const std::byte> bytes);
/// True if `digest` is the scene's: that of its content, or what an older release wrote, of its arena.
[[nodiscard]] bool gives(const Snapshot& scene, const std::string& digest);
/// Makes the edits of a stored scene again. Fails with SCENE_INVALID if that gives another scene than
/// they gave before, with CANCELLED once the guard stops, and with RESOURCE_EXHAUSTED where it
/// grants no memory.
[[nodiscard]] Reply<std::shared_ptr<const Snapshot>> replay_edits(
    std::shared_ptr<const Snapshot> scene, std::uint64_t epoch, const std::vector<KeptEdit>& edits,
    const EditGuard& guard);

}  // namespace raynest::server
