// The rows of a publication besides its scene: by a load, by an edit, and of a scene on the disk.
#pragma once

#include "server/store/disk_room.h"
#include "server/store/named_scene.h"
#include "server/store/share_list.h"
#include "server/store/state_folder.h"

#include <cstdint>
#include <memory>
#include <string>

namespace raynest::server {

/// How a load publishes its scene.
struct Publication {
    bool replace = false;    ///< true: replace different content of that name
    bool temporary = false;  ///< true: drop the scene when its last connection closes
    /// Principals that may use the scene too, or "public". Empty: as before, and at first nobody.
    ShareList share = {};
    /// Digest of the upload that the scene is made of, with all that its import depends on; empty:
    /// none.
    std::string made_of = {};
    BlobPin blob = {};  ///< not null: the scene is stored, by this row
    StoredScene row = {};
};

/// A scene that a request needs and that is on the disk alone.
struct AsleepScene {
    SceneFacts facts;
    std::string owner;
    StoredScene row = {};  ///< whose blob, with its edits, is the scene
    bool has_edits = false;
};

/// How an edit of a scene is made, besides its content.
struct EditPlan {
    StoredScene row = {};       ///< the scene's row; number 0: it is not stored
    std::uint64_t reserve = 0;  ///< not 0: the epoch to reserve before the edit is published
    bool whole = false;         ///< to keep it, the whole scene must be stored
    DiskRoom room = {};         ///< for the scene then
};

/// The work of publish_edit() besides its content.
struct EditPublication {
    EditPlan plan = {};
    /// Not null: gets what to hand in; has the edit's change, if any
    std::shared_ptr<Keeping> keep = {};
    BlobPin blob = {};         ///< the edited scene's, if it is stored whole
    std::uint64_t number = 0;  ///< for its row then
    std::string summary = {};  ///< NamedScene::last_edit
};

}  // namespace raynest::server
