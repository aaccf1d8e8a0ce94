// What an edit names, as a message says it, and how that is kept for the time after a restart.
#pragma once

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
};

/// Takes the lists of a valid message, but for `sources`.
[[nodiscard]] EditContent edit_content(const wire::Edit& message);

/// An edit that adds no scenes, as it is kept.
struct KeptChange {
    EditContent content;
    std::vector<std::byte> bytes;  ///< its rows, vertices and normals, aligned as a float is
};
[[nodiscard]] Reply<std::vector<std::byte>> kept_change(const EditContent& content,
                                                        std::span<const std::byte> bytes);
/// Fails with SCENE_INVALID and the end of a sentence about the edit.
[[nodiscard]] Reply<KeptChange> read_change(const KeptEdit& edit);

}  // namespace raynest::server
