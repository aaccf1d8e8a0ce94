// The rows of an edit, from a client or kept for the time after a restart.
#pragma once

#include "engine/scene/edits/batch.h"
#include "engine/scene/edits/edit_guard.h"
#include "server/ground/errors.h"
#include "server/store/edit_content.h"
#include "server/store/manifest.h"

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

namespace raynest::server {

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

/// True if `digest` is the scene's: that of its content, or what an older release wrote, of its arena.
[[nodiscard]] bool gives(const Snapshot& scene, const std::string& digest);
/// Makes the edits of a stored scene again. Fails with SCENE_INVALID if that gives another scene than
/// they gave before, with CANCELLED once the guard stops, and with RESOURCE_EXHAUSTED where it
/// grants no memory.
[[nodiscard]] Reply<std::shared_ptr<const Snapshot>> replay_edits(
    std::shared_ptr<const Snapshot> scene, std::uint64_t epoch, const std::vector<KeptEdit>& edits,
    const EditGuard& guard);

}  // namespace raynest::server
